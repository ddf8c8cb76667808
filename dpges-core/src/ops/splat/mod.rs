//! `splat`: order-free sums of Gaussians, one per depth interval of a pixel.
//!
//! Gaussians and interval limits → [K, 4, H, W]: for interval k the sums of (colour · α, α) over the
//! Gaussians whose centre depth d satisfies `limit(k−1) ≤ d < limit(k)`; a Gaussian at or behind the
//! last limit is occluded. α = max(0, opacity) · compensation · exp(−½ dᵀ Q d), dropped below 1/255;
//! EWA projection with 0.1 px² low-pass (GES). No order, no sorting.
//!
//! Gradients: from the sums to positions, quaternions, log-scales, opacities and colours. Depth
//! comparisons and limits carry none.

mod backward;
mod cpu;
#[cfg(feature = "gpu")]
pub(super) mod cube;
pub(super) mod footprint;
#[cfg(feature = "gpu")]
pub(super) mod footprint_cube;
pub mod limits;
#[cfg(feature = "gpu")]
mod limits_cube;
#[cfg(test)]
mod tests;

use burn::backend::tensor::FloatTensor;
use burn::backend::{Backend, Dispatch, ExtensionType, backend_extension};
use burn::tensor::Tensor;

use crate::camera::Camera;
use crate::error::Result;
use crate::scene::Gaussians;
use crate::scene::tensors::check_shape;

pub(super) use cpu::{GaussianRows, for_each_group};
pub use footprint::{LOW_PASS, MIN_COMPENSATION_SQUARED};

#[derive(ExtensionType, Debug, Clone)]
pub struct SplatInput<B: Backend> {
    /// [M, 3]
    pub positions: FloatTensor<B>,
    /// [M, 4]
    pub quaternions: FloatTensor<B>,
    /// [M, 3]
    pub log_scales: FloatTensor<B>,
    /// `[M]`
    pub opacities: FloatTensor<B>,
    /// [M, 3]
    pub colours: FloatTensor<B>,
}

#[backend_extension(
    Cube: cfg(feature = "gpu"),
    NdArray: cfg(feature = "ndarray"),
    Flex: cfg(feature = "flex"),
    Autodiff
)]
pub trait SplatOps: Backend {
    fn splat(
        #[extension_type] gaussians: SplatInput<Self>,
        limits: FloatTensor<Self>,
        camera: Camera,
    ) -> FloatTensor<Self>;

    /// Largest contribution of each Gaussian to any pixel, `[M]`; no gradient.
    fn splat_contributions(
        #[extension_type] gaussians: SplatInput<Self>,
        limits: FloatTensor<Self>,
        gates: FloatTensor<Self>,
        camera: Camera,
    ) -> FloatTensor<Self>;
}

#[backend_extension(Cube: cfg(feature = "gpu"), NdArray: cfg(feature = "ndarray"), Flex: cfg(feature = "flex"))]
pub trait SplatBackwardOps: Backend {
    fn splat_backward(
        #[extension_type] gaussians: SplatInput<Self>,
        limits: FloatTensor<Self>,
        grad: FloatTensor<Self>,
        camera: Camera,
    ) -> SplatInput<Self>;
}

pub(super) fn input(gaussians: &Gaussians, colours: Tensor<2>) -> Result<SplatInput<Dispatch>> {
    gaussians.check_shapes()?;
    check_shape("gaussian colours", &colours, [gaussians.len(), 3])?;
    Ok(SplatInput {
        positions: gaussians.positions.clone().into_dispatch(),
        quaternions: gaussians.quaternions.clone().into_dispatch(),
        log_scales: gaussians.log_scales.clone().into_dispatch(),
        opacities: gaussians.opacities.clone().into_dispatch(),
        colours: colours.into_dispatch(),
    })
}

/// Sums [K, 4, H, W] of `gaussians`, coloured `colours` [M, 3] as seen from the camera, for
/// ascending interval `limits` [K, H, W] ([`limits::interval_limits`]).
///
/// # Errors
/// [`crate::Error::Shape`] or [`crate::Error::Camera`] for input that does not fit.
pub fn splat(gaussians: &Gaussians, colours: Tensor<2>, limits: Tensor<3>, camera: &Camera) -> Result<Tensor<4>> {
    camera.validate()?;
    let layers = limits.dims()[0];
    check_shape("limits", &limits, [layers, camera.height, camera.width])?;
    Ok(Tensor::from_dispatch(Dispatch::splat(input(gaussians, colours)?, limits.into_dispatch(), *camera)))
}

/// Largest value over all pixels of α · gate · max|colour| for each Gaussian, `[M]`, where `gates`
/// [K, H, W] is the weight of interval k in the pixel, T_k / (1 + W_G) (GES, pruning). No gradient.
///
/// # Errors
/// [`crate::Error::Shape`] or [`crate::Error::Camera`] for input that does not fit.
pub fn contributions(
    gaussians: &Gaussians,
    colours: Tensor<2>,
    limits: Tensor<3>,
    gates: Tensor<3>,
    camera: &Camera,
) -> Result<Tensor<1>> {
    camera.validate()?;
    let layers = limits.dims()[0];
    check_shape("limits", &limits, [layers, camera.height, camera.width])?;
    check_shape("gates", &gates, [layers, camera.height, camera.width])?;
    let input = input(gaussians, colours)?;
    Ok(Tensor::from_dispatch(Dispatch::splat_contributions(
        input,
        limits.into_dispatch(),
        gates.into_dispatch(),
        *camera,
    )))
}
