//! `interval_limits`: where the depth intervals of every pixel end.
//!
//! ids, alpha and depth [K, H, W] of the layers and margins [N] of the surfels → upper limits [K, H, W],
//! world units, ascending: peeled depths, shifted by the margins or bare (DP-GES, transmittance lookup).
//! +∞ where nothing ends an interval.
//!
//! No gradient.

mod backward;
mod cpu;
#[cfg(feature = "gpu")]
mod cube;
#[cfg(test)]
mod tests;

use burn::backend::tensor::{FloatTensor, IntTensor};
use burn::backend::{Backend, Dispatch, backend_extension};
use burn::tensor::Tensor;

use super::peel::Layers;
use crate::error::Result;
use crate::scene::MarginLookup;
use crate::scene::tensors::check_shape;

#[backend_extension(
    Cube: cfg(feature = "gpu"),
    NdArray: cfg(feature = "ndarray"),
    Flex: cfg(feature = "flex"),
    Autodiff
)]
pub trait LimitOps: Backend {
    fn interval_limits(
        ids: IntTensor<Self>,
        alpha: FloatTensor<Self>,
        depth: FloatTensor<Self>,
        margins: FloatTensor<Self>,
        lookup: MarginLookup,
    ) -> FloatTensor<Self>;
}

/// Upper limits [K, H, W] of the depth intervals of every pixel, ascending, for `margins` [N] of the
/// surfels (DP-GES, transmittance lookup). No gradient.
///
/// A Gaussian at depth d belongs to the first layer with `d < D + ε`, or with `d < D` where `lookup`
/// is [`MarginLookup::Literal`], or else to the K-th; a missing layer lies at infinity. A pixel is
/// closed when its last layer is opaque or is the K-th: then nothing at or behind `D + ε` of the last
/// layer is visible, whatever the lookup. With a running maximum and that cap the intervals are
/// `limit(k−1) ≤ d < limit(k)`.
///
/// # Errors
/// [`crate::Error::Shape`] if the layers' tensors do not agree.
pub fn interval_limits(layers: &Layers, margins: &Tensor<1>, lookup: MarginLookup) -> Result<Tensor<3>> {
    let shape = layers.depth.dims();
    check_shape("layers.alpha", &layers.alpha, shape)?;
    Ok(Tensor::from_dispatch(Dispatch::interval_limits(
        layers.ids.clone().into_dispatch(),
        layers.alpha.clone().into_dispatch(),
        layers.depth.clone().into_dispatch(),
        margins.clone().into_dispatch(),
        lookup,
    )))
}
