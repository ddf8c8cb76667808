//! One view of a scene of Gaussians that are summed in any order (Hou et al., "Sort-free Gaussian Splatting via Weighted Sum
//! Rendering").

use burn::tensor::{DType, Device, Tensor};

use super::{ViewRequest, shown, validate_gaussians};
use crate::camera::Camera;
use crate::counters::transfers::uploaded;
use crate::error::{Error, Result};
use crate::ops::colour::colour;
use crate::ops::harmonics::harmonics;
use crate::ops::splat::splat_probed;
use crate::scene::{DepthWeight, Gaussians, SceneInfo, ScreenFilter, WeightedSum};

/// Largest logarithm of d^β.
const LARGEST_LOGARITHM: f64 = 80.0;

/// The numbers that all Gaussians of a [`WeightedSum`] share, each [1, 1].
#[derive(Clone, Debug)]
pub struct WeightedSumTensors {
    /// σ, used as at least [`WeightedSum::LEAST_SIGMA`].
    pub sigma: Tensor<2>,
    /// β
    pub beta: Tensor<2>,
    /// w_b, used as at least [`WeightedSum::LEAST_BACKGROUND`].
    pub background: Tensor<2>,
}

impl WeightedSumTensors {
    pub fn new(sum: &WeightedSum, device: &Device, dtype: DType) -> Self {
        let number = |value: f32| uploaded(vec![value], [1, 1], device, dtype);
        Self { sigma: number(sum.sigma), beta: number(sum.beta), background: number(sum.background) }
    }
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SummedOptions {
    pub weight: DepthWeight,
    /// Display-referred colour behind everything.
    pub background: [f64; 3],
    pub depth: bool,
}

impl SummedOptions {
    /// Without depth.
    ///
    /// # Errors
    /// [`Error::Option`] if the scene is not one of weighted sums.
    pub fn new(info: &SceneInfo) -> Result<Self> {
        match &info.weighted_sum {
            Some(sum) => Ok(Self { weight: sum.weight, background: info.background, depth: false }),
            None => {
                let (expected, found) = ("summed".to_owned(), info.rendering.to_string());
                Err(Error::Option { option: "rendering", expected, found })
            }
        }
    }
}

/// A rendered view of summed Gaussians.
#[derive(Clone, Debug)]
pub struct SummedRender {
    /// [3, H, W] display-referred, not clamped, on the background.
    pub image: Tensor<3>,
    /// [1, H, W] share of the Gaussians in the weight of a pixel; the rest is the background's.
    pub alpha: Tensor<3>,
    /// [1, H, W] mean depth of the Gaussians by their weights, times alpha, world units; with [`SummedOptions::depth`].
    pub depth: Option<Tensor<3>>,
}

impl SummedRender {
    /// The same view with an [environment](mod@crate::ops::environment) [3, H, W] behind everything, which adds to the
    /// background: `(1 − alpha) E`.
    #[must_use]
    pub fn in_front_of(self, environment: Tensor<3>) -> Self {
        Self { image: self.image + shown(&self.alpha, environment), ..self }
    }
}

/// Renders a view, of which a camera is enough, of `gaussians`, in any order: the formula of [`WeightedSum`]. Colours below 0 count as 0 (3DGS), and
/// so do factors of opacities. α w below 1/255 counts as 0, as in the published code of the method. The low-pass filter is
/// that of 3DGS. Depths of the centres carry gradients to positions and to what is `common`; directions carry none.
///
/// # Errors
/// A typed error naming what does not fit: see [`validate_gaussians`], [`Camera::validate`]. [`Error::Shape`] if opacities do
/// not depend on the direction. Also [`Error::Capacity`].
pub fn render_summed<'a>(
    gaussians: &Gaussians,
    common: &WeightedSumTensors,
    view: impl Into<ViewRequest<'a>>,
    options: &SummedOptions,
) -> Result<SummedRender> {
    let ViewRequest { camera, values, pose, probe, .. } = view.into();
    camera.validate()?;
    validate_gaussians(gaussians, values)?;
    let centre = camera.centre().to_array();
    let colours = colour(&gaussians.colour, &gaussians.positions, centre)?.clamp_min(0.0);
    let factors = harmonics(&gaussians.opacity_base, &gaussians.opacity_detail, &gaussians.positions, centre)?;
    let mut gaussians = pose.map_or_else(|| gaussians.clone(), |probe| probe.gaussians(gaussians));
    let depths = if gaussians.is_empty() { factors.clone() } else { depths(&gaussians.positions, camera) };
    // not by kernels, which some devices refuse to launch over nothing
    if !gaussians.is_empty() {
        gaussians.opacities = gaussians.opacities * factors.clamp_min(0.0) * weights(&depths, common, options.weight);
    }

    let (device, dtype) = (colours.device(), colours.dtype());
    // one interval that never ends; its slope, which does not matter, is more than 0
    let everywhere = Tensor::full([2, camera.height, camera.width], f32::INFINITY, (&device, dtype));
    let planes = |sums: Tensor<4>, first: usize, count: usize| {
        let part = sums.slice([0..1, first..first + count, 0..camera.height, 0..camera.width]);
        part.reshape([count, camera.height, camera.width])
    };
    let splat =
        |colours: &Tensor<2>, probe| splat_probed(&gaussians, colours, &everywhere, probe, camera, ScreenFilter::Plain);
    let sums = splat(&colours, probe)?;
    let background = common.background.clone().clamp_min(WeightedSum::LEAST_BACKGROUND).reshape([1, 1, 1]);
    let total = planes(sums.clone(), 3, 1) + background;
    let alpha = planes(sums.clone(), 3, 1) / total.clone();
    // w_b C_b over the total; as a product with w_b its gradient would cancel where there is no Gaussian
    let behind = shown(&alpha, uploaded(options.background.to_vec(), [3, 1, 1], &device, dtype));
    let image = planes(sums, 0, 3) / total.clone() + behind;
    let depth = if options.depth {
        let of_depths = splat(&depths.repeat_dim(1, 3), None)?;
        Some(planes(of_depths, 0, 1) / total)
    } else {
        None
    };
    Ok(SummedRender { image, alpha, depth })
}

/// [M, 1] depths of `positions` [M, 3], world units: what splatting sorts into intervals by.
fn depths(positions: &Tensor<2>, camera: &Camera) -> Tensor<2> {
    let (device, dtype) = (positions.device(), positions.dtype());
    let pose = &camera.camera_from_world;
    let row = |numbers: [f64; 3]| uploaded(numbers.to_vec(), [1, 3], &device, dtype);
    if camera.lens.is_some_and(|lens| lens.is_wide()) {
        let offset = positions.clone() - row(camera.centre().to_array());
        return (offset.clone() * offset).sum_dim(1).clamp_min(f64::from(f32::MIN_POSITIVE)).sqrt();
    }
    let forward = row(pose.rotation.row(2).to_array());
    (positions.clone() * forward).sum_dim(1) + pose.translation.z
}

/// [M, 1] w(d) of `depths` [M, 1]; what lies behind the camera has any finite weight.
fn weights(depths: &Tensor<2>, common: &WeightedSumTensors, weight: DepthWeight) -> Tensor<2> {
    let sigma = || common.sigma.clone().clamp_min(WeightedSum::LEAST_SIGMA);
    match weight {
        DepthWeight::Direct => depths.ones_like(),
        DepthWeight::Exponential => {
            let logarithms = depths.clone().clamp_min(WeightedSum::LEAST_SIGMA).log() * common.beta.clone();
            // a larger power is infinite in f32, and its gradient no number
            let powers = logarithms.clamp_max(LARGEST_LOGARITHM).exp();
            (powers * sigma() * -1.0).exp()
        }
        DepthWeight::Linear => (depths.clone() / sigma() * -1.0 + 1.0).clamp_min(0.0),
    }
}

#[cfg(test)]
mod tests;
