//! `splat`: order-free sums of Gaussians, one per depth interval of a pixel.
//!
//! Gaussians and interval limits → [K, 4, H, W]: for interval k the sums of (colour · α, α) over the
//! Gaussians whose centre depth d satisfies `limit(k−1) ≤ d < limit(k)`. A Gaussian at or behind the last
//! limit is occluded. α = max(0, opacity) · compensation · exp(−½ dᵀ Q d), or 0 if that is below 1/255, by
//! EWA projection with a low-pass filter of 0.1 px² (GES).
//!
//! Gradients: from the sums to positions, quaternions, log-scales, opacities and colours. Depth
//! comparisons and limits carry none.

mod backward;
mod cpu;
#[cfg(feature = "gpu")]
mod cube;
#[cfg(test)]
mod tests;

use burn::backend::tensor::FloatTensor;
use burn::backend::{Backend, Dispatch, backend_extension};
use burn::tensor::Tensor;

use crate::camera::Camera;
use crate::error::Result;
use crate::footprint::gaussian::tensors::GaussianTensors;
use crate::scene::Gaussians;
use crate::scene::tensors::check_shape;
use crate::tiles::capacity::within_capacity;

#[backend_extension(
    Cube: cfg(feature = "gpu"),
    NdArray: cfg(feature = "ndarray"),
    Flex: cfg(feature = "flex"),
    Autodiff
)]
pub trait SplatOps: Backend {
    fn splat(
        #[extension_type] gaussians: GaussianTensors<Self>,
        limits: FloatTensor<Self>,
        camera: Camera,
    ) -> FloatTensor<Self>;

    /// Largest contribution of each Gaussian to any pixel, `[M]`; no gradient.
    fn splat_contributions(
        #[extension_type] gaussians: GaussianTensors<Self>,
        limits: FloatTensor<Self>,
        gates: FloatTensor<Self>,
        camera: Camera,
    ) -> FloatTensor<Self>;
}

#[backend_extension(Cube: cfg(feature = "gpu"), NdArray: cfg(feature = "ndarray"), Flex: cfg(feature = "flex"))]
pub trait SplatBackwardOps: Backend {
    fn splat_backward(
        #[extension_type] gaussians: GaussianTensors<Self>,
        limits: FloatTensor<Self>,
        grad: FloatTensor<Self>,
        camera: Camera,
    ) -> GaussianTensors<Self>;
}

/// Sums [K, 4, H, W] of `gaussians` in `colours` [M, 3], as seen from the camera, for ascending interval
/// `limits` [K, H, W] ([`interval_limits`](super::limits::interval_limits)).
///
/// # Errors
/// [`crate::Error::Shape`] or [`crate::Error::Camera`] if the input is invalid, [`crate::Error::Capacity`] if the tile lists
/// or the sums do not fit a buffer.
pub fn splat(gaussians: &Gaussians, colours: &Tensor<2>, limits: &Tensor<3>, camera: &Camera) -> Result<Tensor<4>> {
    camera.validate()?;
    let layers = limits.dims()[0];
    check_shape("limits", limits, [layers, camera.height, camera.width])?;
    let gaussians = GaussianTensors::new(gaussians, colours)?;
    let limits = limits.clone().into_dispatch();
    Ok(Tensor::from_dispatch(within_capacity(|| Dispatch::splat(gaussians, limits, *camera))?))
}

/// Largest value over all pixels of α · gate · max|colour| for each Gaussian, `[M]`, where `gates`
/// [K, H, W] is the weight of interval k in the pixel, T_k / (1 + W_G) (GES, pruning). No gradient.
///
/// # Errors
/// The errors of [`splat`](fn@splat).
pub fn contributions(
    gaussians: &Gaussians,
    colours: &Tensor<2>,
    limits: &Tensor<3>,
    gates: &Tensor<3>,
    camera: &Camera,
) -> Result<Tensor<1>> {
    camera.validate()?;
    let layers = limits.dims()[0];
    check_shape("limits", limits, [layers, camera.height, camera.width])?;
    check_shape("gates", gates, [layers, camera.height, camera.width])?;
    let input = GaussianTensors::new(gaussians, colours)?;
    let [limits, gates] = [limits, gates].map(|tensor| tensor.clone().into_dispatch());
    let found = within_capacity(|| Dispatch::splat_contributions(input, limits, gates, *camera))?;
    Ok(Tensor::from_dispatch(found))
}
