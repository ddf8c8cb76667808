//! `ssim`: mean structural similarity of two images.
//!
//! Two images [C, H, W] in [0, 1] → `[1]`: 11 × 11 Gaussian window with σ = 1.5 px, zero padding,
//! C1 = 0.01², C2 = 0.03², mean over pixels and channels (3DGS).
//!
//! Gradient: to the first image; the second is the target.

mod backward;
mod cpu;
#[cfg(feature = "gpu")]
mod cube;
#[cfg(test)]
mod tests;

use burn::backend::tensor::FloatTensor;
use burn::backend::{Backend, Dispatch, ExtensionType, backend_extension};
use burn::tensor::Tensor;

use crate::error::Result;
use crate::scene::tensors::check_shape;

#[derive(ExtensionType, Debug, Clone)]
pub struct SsimOutput<B: Backend> {
    /// `[1]`
    pub value: FloatTensor<B>,
    /// [3, C, H, W] derivatives of the value with respect to the windowed means of a, a² and a·b
    pub partials: FloatTensor<B>,
}

#[backend_extension(
    Cube: cfg(feature = "gpu"),
    NdArray: cfg(feature = "ndarray"),
    Flex: cfg(feature = "flex"),
    Autodiff
)]
pub trait SsimOps: Backend {
    fn ssim(image: FloatTensor<Self>, target: FloatTensor<Self>) -> SsimOutput<Self>;
}

#[backend_extension(Cube: cfg(feature = "gpu"), NdArray: cfg(feature = "ndarray"), Flex: cfg(feature = "flex"))]
pub trait SsimBackwardOps: Backend {
    fn ssim_backward(
        image: FloatTensor<Self>,
        target: FloatTensor<Self>,
        partials: FloatTensor<Self>,
        grad: FloatTensor<Self>,
    ) -> FloatTensor<Self>;
}

/// Mean SSIM `[1]` of `image` against `target`, both [C, H, W].
///
/// # Errors
/// [`crate::Error::Shape`] if the two differ in shape.
pub fn ssim(image: &Tensor<3>, target: &Tensor<3>) -> Result<Tensor<1>> {
    check_shape("target", target, image.dims())?;
    Ok(Tensor::from_dispatch(Dispatch::ssim(image.clone().into_dispatch(), target.clone().into_dispatch()).value))
}
