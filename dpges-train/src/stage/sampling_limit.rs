//! The filter that keeps Gaussians from being finer than what the training views resolve (Mip-Splatting).

use burn::tensor::{DType, Device, Tensor};
use dpges_core::camera::Camera;
use dpges_core::scene::tensors::{rows_to_tensor, tensor_to_rows};
use dpges_core::scene::{GaussianData, Gaussians};

use super::Context;
use crate::refine::sampling::finest_pixels;

/// Standard deviations of a filter in the world, one for each Gaussian. A Gaussian is drawn as itself convolved with its
/// filter: scales √(s² + f²), and an opacity that keeps its weight.
pub struct SamplingLimit {
    /// Of a pixel at the Gaussian, px.
    smoothing_px: f64,
    /// [M, 1] world units.
    deviations: Tensor<2>,
}

impl SamplingLimit {
    /// Name of its column in a checkpoint.
    pub const NAME: &'static str = "sampling_limit";

    /// The filter of Gaussians at `positions` [M, 3], `smoothing_px` wide in the training view that resolves each best.
    pub fn new(positions: &Tensor<2>, smoothing_px: f64, context: &Context) -> Self {
        let cameras: Vec<&Camera> = context.dataset.train.iter().map(|view| &view.camera).collect();
        let mut deviations = finest_pixels(&tensor_to_rows(positions), &cameras);
        deviations.iter_mut().for_each(|pixel| *pixel *= smoothing_px as f32);
        Self::from_column(&deviations, smoothing_px, &context.device)
    }

    /// From what [`column`](Self::column) returned.
    pub fn from_column(column: &[f32], smoothing_px: f64, device: &Device) -> Self {
        Self { smoothing_px, deviations: rows_to_tensor(column, 1, device, DType::F32) }
    }

    pub fn column(&self) -> Vec<f32> {
        tensor_to_rows(&self.deviations)
    }

    /// Measures anew, after Gaussians moved, came or went.
    pub fn measure(&mut self, positions: &Tensor<2>, context: &Context) {
        *self = Self::new(positions, self.smoothing_px, context);
    }

    /// `gaussians` as they are drawn. Gradients pass through to scales and opacities, none to the filter.
    pub fn smoothed(&self, gaussians: &Gaussians) -> Gaussians {
        let [count, _] = self.deviations.dims();
        if count == 0 {
            return gaussians.clone();
        }
        let like = &gaussians.log_scales;
        let deviations = if like.is_autodiff() { self.deviations.clone().autodiff() } else { self.deviations.clone() };
        let log_scales = ((like.clone() * 2.0).exp() + (deviations.clone() * deviations)).clamp_min(1e-30).log() * 0.5;
        let dimming = (like.clone() - log_scales.clone()).sum_dim(1).exp();
        Gaussians { opacities: gaussians.opacities.clone() * dimming, log_scales, ..gaussians.clone() }
    }

    /// The same on the host.
    pub fn bake(&self, gaussians: &mut GaussianData) {
        for (row, deviation) in self.column().into_iter().enumerate() {
            let mut dimming = 0.0;
            for log_scale in &mut gaussians.log_scales[3 * row..][..3] {
                let before = f64::from(*log_scale);
                let after = 0.5 * ((2.0 * before).exp() + f64::from(deviation).powi(2)).ln();
                dimming += before - after;
                *log_scale = after as f32;
            }
            gaussians.opacities[row] *= dimming.exp() as f32;
        }
    }
}
