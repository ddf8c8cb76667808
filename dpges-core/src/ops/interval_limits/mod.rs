//! `interval_limits`: the ends of the depth intervals of every pixel.
//!
//! ids, alpha and depth [K, H, W] of the layers and margins [N, 1] of the surfels → upper limits [K, H, W],
//! world units, ascending: the depths of the layers, with or without the margins (DP-GES, transmittance lookup).
//! An interval without an end has the limit +∞.
//!
//! No gradient.

mod cpu;
#[cfg(feature = "gpu")]
mod cube;
#[cfg(test)]
mod tests;

use burn::backend::tensor::FloatTensor;
use burn::backend::{Backend, Dispatch, backend_extension};
use burn::tensor::Tensor;

use super::peel::{Layers, PeelOutput};
use crate::error::Result;
use crate::scene::MarginLookup;
use crate::scene::tensors::{check_shape, flat};

#[backend_extension(Cube: cfg(feature = "gpu"), NdArray: cfg(feature = "ndarray"), Flex: cfg(feature = "flex"))]
pub trait LimitOps: Backend {
    fn interval_limits(
        #[extension_type] layers: PeelOutput<Self>,
        margins: FloatTensor<Self>,
        lookup: MarginLookup,
    ) -> FloatTensor<Self>;
}

/// Upper limits [K, H, W] of the depth intervals of every pixel, ascending, for `margins` [N, 1] of the
/// surfels (DP-GES, transmittance lookup). No gradient.
///
/// A Gaussian at depth d belongs to the first layer with `d < D + ε`, or with `d < D` if `lookup` is
/// [`MarginLookup::Literal`], and otherwise to the K-th layer. A missing layer lies at infinity. A pixel is
/// closed if its last layer is opaque or is the K-th: with either lookup, nothing at or behind `D + ε` of the
/// last layer is visible. The limits are the running maximum, capped there, so that interval k is
/// `limit(k−1) ≤ d < limit(k)`.
///
/// # Errors
/// [`crate::Error::Shape`] if the layers' tensors do not agree.
pub fn interval_limits(layers: &Layers, margins: &Tensor<2>, lookup: MarginLookup) -> Result<Tensor<3>> {
    let shape = layers.depth.dims();
    check_shape("layers.alpha", &layers.alpha, shape)?;
    let [alpha, depth] = [&layers.alpha, &layers.depth].map(|tensor| tensor.clone().inner().into_dispatch());
    let input = PeelOutput { ids: layers.ids.clone().inner().into_dispatch(), alpha, depth };
    let margins = flat(margins).inner().into_dispatch();
    let limits = Tensor::from_dispatch(Dispatch::interval_limits(input, margins, lookup));
    Ok(if layers.depth.is_autodiff() { limits.autodiff() } else { limits })
}
