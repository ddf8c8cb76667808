//! `scale_loss`: what surfels cost that are larger than others.
//!
//! Log-scales [N, 2] → `[1]` L_scale: the mean over surfels of exp(x), where x is the mean of a surfel's two scales divided by
//! the mean of all scales, which carries no gradient (DP-GES). From [`LINEAR_FROM`] on its tangent takes the place of the
//! exponential, so that one huge surfel neither overflows nor loses its gradient. 0 without surfels.
//!
//! The mean is found relative to the largest scale: scales of surfels that no view sees shrink until their exponentials are 0.
//!
//! Gradient: from the weighted loss to the log-scales.

mod autodiff;
mod cpu;
#[cfg(feature = "gpu")]
mod cube;
#[cfg(test)]
mod tests;

use burn::backend::tensor::FloatTensor;
use burn::backend::{Backend, Dispatch, ExtensionType, backend_extension};
use burn::tensor::Tensor;

/// x from which on the tangent continues the exponential.
pub const LINEAR_FROM: f64 = 20.0;

/// `[1]` each
#[derive(ExtensionType, Debug, Clone)]
pub struct ScaleLossOutput<B: Backend> {
    pub weighted: FloatTensor<B>,
    pub value: FloatTensor<B>,
    /// Logarithm of the mean scale.
    pub log_mean: FloatTensor<B>,
}

#[backend_extension(
    Cube: cfg(feature = "gpu"),
    NdArray: cfg(feature = "ndarray"),
    Flex: cfg(feature = "flex"),
    Autodiff
)]
pub trait ScaleLossOps: Backend {
    fn scale_loss(log_scales: FloatTensor<Self>, weight: f64) -> ScaleLossOutput<Self>;
}

/// The results of [`scale_loss`], `[1]` each.
#[derive(Clone, Debug)]
pub struct ScaleLoss {
    /// L_scale times its weight.
    pub weighted: Tensor<1>,
    /// L_scale, without gradient.
    pub value: Tensor<1>,
}

/// The scale loss of `log_scales` [N, 2], with a `weight`.
pub fn scale_loss(log_scales: &Tensor<2>, weight: f64) -> ScaleLoss {
    if log_scales.dims()[0] == 0 {
        let none = Tensor::zeros([1], (&log_scales.device(), log_scales.dtype()));
        return ScaleLoss { weighted: none.clone(), value: none };
    }
    let out = Dispatch::scale_loss(log_scales.clone().into_dispatch(), weight);
    ScaleLoss { weighted: Tensor::from_dispatch(out.weighted), value: Tensor::from_dispatch(out.value) }
}
