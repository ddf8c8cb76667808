//! `splat`: order-free sums of Gaussians, one per depth interval of a pixel.
//!
//! Gaussians and limits [K + 1, H, W] → [K, 4, H, W]: for interval k the sums of (colour · α, α) over the Gaussians, each by
//! its share `f_k − f_{k−1}`, where `f_k = clamp((limit_k − d) slope, 0, 1)` is the share of a Gaussian with centre depth d that
//! is before layer k, f_{−1} = 0. The last plane of the limits is the slope; with a steep one the shares are 0 or 1. A
//! Gaussian behind the last limit is occluded. α = max(0, opacity) · compensation · exp(−½ dᵀ Q d), or 0 if that is below 1/255, by
//! EWA projection with a low-pass filter of 0.1 px² (GES); or, with [`ScreenFilter::Plain`], of 0.3 px² without
//! compensation (3DGS).
//!
//! Gradients: from the sums to positions, quaternions, log-scales, opacities and colours. Depth
//! comparisons and limits carry none.
//!
//! The *probe* is a [M, 2] tensor that no value depends on. Its gradient is that with respect to the projected centre in
//! units of half the image. 3DGS bases densification on it.

mod autodiff;
mod cpu;
#[cfg(feature = "gpu")]
mod cube;
#[cfg(test)]
mod tests;

use burn::backend::tensor::FloatTensor;
use burn::backend::{Backend, Dispatch, ExtensionType, backend_extension};
use burn::tensor::{Tensor, TensorData};

use crate::backend::kept::Kept;
use crate::camera::Camera;
use crate::error::Result;
use crate::footprint::gaussian::tensors::GaussianTensors;
use crate::scene::tensors::check_shape;
use crate::scene::{Gaussians, ScreenFilter};
use crate::tiles::capacity::within_capacity;

#[derive(ExtensionType, Debug, Clone)]
pub struct SplatInput<B: Backend> {
    #[extension_type]
    pub gaussians: GaussianTensors<B>,
    /// [M, 2], or [0, 2] without a probe
    pub probe: FloatTensor<B>,
    /// [K + 1, H, W]
    pub limits: FloatTensor<B>,
}

#[backend_extension(
    Cube: cfg(feature = "gpu"),
    NdArray: cfg(feature = "ndarray"),
    Flex: cfg(feature = "flex"),
    Autodiff
)]
pub trait SplatOps: Backend {
    /// On the tape, CPU kernels keep the projected Gaussians in `kept` for the backward pass; GPU kernels project them again.
    fn splat(
        #[extension_type] input: SplatInput<Self>,
        camera: Camera,
        filter: ScreenFilter,
        kept: Kept,
    ) -> FloatTensor<Self>;

    /// Largest contribution of each Gaussian to any pixel, `[M]`; no gradient.
    fn splat_contributions(
        #[extension_type] gaussians: GaussianTensors<Self>,
        limits: FloatTensor<Self>,
        gates: FloatTensor<Self>,
        camera: Camera,
    ) -> FloatTensor<Self>;
}

/// The tensors of Gaussians, then that of the probe.
fn with_probe<V>([positions, quaternions, log_scales, opacities, colours]: [V; 5], probe: V) -> [V; 6] {
    [positions, quaternions, log_scales, opacities, colours, probe]
}

/// Sums [K, 4, H, W] of `gaussians` in `colours` [M, 3], as seen from the camera, between ascending
/// `limits` [K + 1, H, W] ([`Visibility::limits`](super::visibility::Visibility::limits)).
///
/// # Errors
/// [`crate::Error::Shape`] or [`crate::Error::Camera`] if the input is invalid, [`crate::Error::Capacity`] if the tile lists
/// or the sums do not fit a buffer.
pub fn splat(gaussians: &Gaussians, colours: &Tensor<2>, limits: &Tensor<3>, camera: &Camera) -> Result<Tensor<4>> {
    splat_probed(gaussians, colours, limits, None, camera, ScreenFilter::Compensated)
}

/// [`splat`](fn@splat) with another `filter`, and a `probe` [M, 2] of which only the gradient means anything.
///
/// # Errors
/// The errors of [`splat`](fn@splat).
pub fn splat_probed(
    gaussians: &Gaussians,
    colours: &Tensor<2>,
    limits: &Tensor<3>,
    probe: Option<&Tensor<2>>,
    camera: &Camera,
    filter: ScreenFilter,
) -> Result<Tensor<4>> {
    camera.validate()?;
    check_limits(limits, camera)?;
    let probe = match probe {
        Some(probe) => {
            check_shape("probe", probe, [gaussians.len(), 2])?;
            probe.clone()
        }
        None => {
            let nothing = TensorData::new(Vec::<f32>::new(), [0, 2]).convert_dtype(colours.dtype());
            Tensor::from_data(nothing, (&colours.device(), colours.dtype()))
        }
    };
    let input = SplatInput {
        gaussians: GaussianTensors::new(gaussians, colours)?,
        probe: probe.into_dispatch(),
        limits: limits.clone().into_dispatch(),
    };
    let sums = within_capacity(|| Dispatch::splat(input, *camera, filter, Kept::default()))?;
    Ok(Tensor::from_dispatch(sums))
}

/// Number of layers.
fn check_limits(limits: &Tensor<3>, camera: &Camera) -> Result<usize> {
    let layers = limits.dims()[0].saturating_sub(1).max(1);
    check_shape("limits", limits, [layers + 1, camera.height, camera.width])?;
    Ok(layers)
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
    let layers = check_limits(limits, camera)?;
    check_shape("gates", gates, [layers, camera.height, camera.width])?;
    let input = GaussianTensors::new(gaussians, colours)?;
    let [limits, gates] = [limits, gates].map(|tensor| tensor.clone().into_dispatch());
    let found = within_capacity(|| Dispatch::splat_contributions(input, limits, gates, *camera))?;
    Ok(Tensor::from_dispatch(found))
}
