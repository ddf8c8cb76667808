//! `visibility`: how much of each layer of a pixel is seen, and of what lies behind it.
//!
//! ids, alpha and depth [K, H, W] of the layers, nearest first, and margins [N, 1] of the surfels →
//! * weights [K, H, W], the share of each layer in the surfel image; they add up to 1 − T_K;
//! * transmittances [K + 1, H, W], `T_k = Π_{j≤k} (1 − A_j)` with T_0 = 1;
//! * limits [K + 1, H, W]: for each layer the depth from which on a Gaussian is wholly behind it, ascending, world units,
//!   +∞ if none is; then the slope, per world unit. A Gaussian at depth d is before layer k by the share
//!   `clamp((limit_k − d) slope, 0, 1)`. Steps have the slope [`STEP`].
//!
//! With [`Peeling::Continuous`] layer i is behind layer j by the share `s_ij = clamp(½ + (D_i − D_j) / (2 δ), 0, 1)`,
//! `δ = ORDER min(ε_i, ε_j)`, and weighs `A_i Π_{j≠i} (1 − A_j s_ij)`, times what makes the sum of all 1 − T_K. So two layers at
//! one depth may change places. A limit is `D + ε + h / 2`, the slope 1 / h, `h = RAMP ε`, with one ε for the pixel: the mean
//! of its layers' by their weights. Limits of layers as near as each other are then equal, whatever their order.
//! Otherwise a layer weighs `A_k T_{k−1}`, and limits are steps at D + ε of each layer, or at D (DP-GES, transmittance lookup).
//!
//! Gradients: from weights and transmittances to alpha and depth, without a division by 1 − A or T, which are exactly 0
//! behind an opaque layer. Limits and margins have none.

mod autodiff;
mod cpu;
#[cfg(feature = "gpu")]
mod cube;
#[cfg(test)]
mod tests;

use burn::backend::tensor::{FloatTensor, IntTensor};
use burn::backend::{Backend, Dispatch, ExtensionType, backend_extension};
use burn::tensor::Tensor;

use super::peel::Layers;
use crate::error::Result;
use crate::scene::Peeling;
#[cfg(doc)]
use crate::scene::peeling::STEP;
use crate::scene::tensors::{check_shape, flat};

#[derive(ExtensionType, Debug, Clone)]
pub struct VisibilityInput<B: Backend> {
    /// [K, H, W]
    pub alpha: FloatTensor<B>,
    /// [K, H, W]
    pub depth: FloatTensor<B>,
    /// [K, H, W]
    pub ids: IntTensor<B>,
    /// `[N]`
    pub margins: FloatTensor<B>,
}

#[derive(ExtensionType, Debug, Clone)]
pub struct VisibilityOutput<B: Backend> {
    pub weights: FloatTensor<B>,
    pub transmittance: FloatTensor<B>,
    pub limits: FloatTensor<B>,
}

/// The state for the backward pass.
#[derive(Debug, Clone)]
pub struct VisibilityState<B: Backend> {
    input: VisibilityInput<B>,
    peeling: Peeling,
}

#[backend_extension(
    Cube: cfg(feature = "gpu"),
    NdArray: cfg(feature = "ndarray"),
    Flex: cfg(feature = "flex"),
    Autodiff
)]
pub trait VisibilityOps: Backend {
    fn visibility(#[extension_type] input: VisibilityInput<Self>, peeling: Peeling) -> VisibilityOutput<Self>;
}

/// The visibility of the layers of a view, and of what lies behind them.
#[derive(Clone, Debug)]
pub struct Visibility {
    /// [K, H, W] share of each layer in the surfel image
    pub weights: Tensor<3>,
    /// [K + 1, H, W] T_0 = 1 … T_K
    pub transmittance: Tensor<3>,
    /// [K + 1, H, W] the ends of the depth intervals of Gaussians and the slope of their tests
    pub limits: Tensor<3>,
}

impl Visibility {
    /// [1, H, W] T_K: the share of what is behind all layers.
    pub fn behind_all(&self) -> Tensor<3> {
        let last = self.transmittance.dims()[0] - 1;
        self.transmittance.clone().slice_dim(0, last..=last)
    }
}

/// The visibility of `layers`, for `margins` [N, 1] of the surfels.
///
/// # Errors
/// [`crate::Error::Shape`] if the layers' tensors do not agree.
pub fn visibility(layers: &Layers, margins: &Tensor<2>, peeling: Peeling) -> Result<Visibility> {
    check_shape("layers.alpha", &layers.alpha, layers.depth.dims())?;
    let input = VisibilityInput {
        alpha: layers.alpha.clone().into_dispatch(),
        depth: layers.depth.clone().into_dispatch(),
        ids: layers.ids.clone().into_dispatch(),
        margins: flat(margins).into_dispatch(),
    };
    let out = Dispatch::visibility(input, peeling);
    Ok(Visibility {
        weights: Tensor::from_dispatch(out.weights),
        transmittance: Tensor::from_dispatch(out.transmittance),
        limits: Tensor::from_dispatch(out.limits),
    })
}
