//! What pruning wants to know about the views since the last pruning. It stays on the device.

use burn::tensor::{DType, Device, Int, Tensor, TensorData};
use dpges_core::camera::Camera;
use dpges_core::ops::coverage::coverage;
use dpges_core::ops::splat::contributions;
use dpges_core::render::Render;
use dpges_core::scene::Gaussians;
use dpges_core::scene::schema::Columns;
use dpges_core::scene::tensors::tensor_to_rows;

use crate::config::Schedule;
use crate::refine::RowEdit;

/// Running maxima over views.
#[derive(Clone, Debug)]
pub struct Statistics {
    /// [N] largest number of pixels of one view at which a surfel was the nearest.
    max_pixels: Tensor<1, Int>,
    /// [M] largest contribution of a Gaussian to a pixel, in units of colour.
    max_contributions: Tensor<1>,
}

impl Statistics {
    pub fn new(surfels: usize, gaussians: usize, device: &Device) -> Self {
        Self::from_rows(&vec![0; surfels], &vec![0.0; gaussians], device)
    }

    /// From what [`max_pixels`](Self::max_pixels) and [`max_contributions`](Self::max_contributions) returned.
    pub fn from_rows(max_pixels: &[u32], max_contributions: &[f32], device: &Device) -> Self {
        let pixels: Vec<i32> = max_pixels.iter().map(|&count| i32::try_from(count).unwrap_or(i32::MAX)).collect();
        let pixels = TensorData::new(pixels, [max_pixels.len()]);
        let contributions = TensorData::new(max_contributions.to_vec(), [max_contributions.len()]);
        Self {
            max_pixels: Tensor::from_data(pixels, (device, DType::I32)),
            max_contributions: Tensor::from_data(contributions, (device, DType::F32)),
        }
    }

    pub fn max_pixels(&self) -> Vec<u32> {
        self.max_pixels.clone().into_data().iter::<i64>().map(|count| u32::try_from(count).unwrap_or(0)).collect()
    }

    pub fn max_contributions(&self) -> Vec<f32> {
        tensor_to_rows(&self.max_contributions)
    }

    /// Forgets what was observed of surfels; from now on there are `count`.
    pub fn reset_surfels(&mut self, count: usize) {
        let device = self.max_pixels.device();
        self.max_pixels = Self::new(count, 0, &device).max_pixels;
    }

    /// Keeps what was observed of the surfels that stay.
    pub fn keep_surfels(&mut self, rows: &RowEdit) {
        let pixels = self.max_pixels();
        let kept: Vec<u32> = rows.keep.iter().map(|&row| pixels[row]).collect();
        self.max_pixels = Self::from_rows(&kept, &[], &self.max_pixels.device()).max_pixels;
    }

    /// Forgets what was observed of Gaussians; from now on there are `count`.
    pub fn reset_gaussians(&mut self, count: usize) {
        let device = self.max_contributions.device();
        self.max_contributions = Self::new(0, count, &device).max_contributions;
    }

    /// Adds one view rendered from `gaussians` on a tape, as far as a pruning of `schedule` after `completed_steps` needs it.
    ///
    /// # Errors
    /// [`dpges_core::Error`] if the render belongs to other Gaussians.
    pub fn observe(
        &mut self,
        render: &Render,
        gaussians: &Gaussians,
        camera: &Camera,
        schedule: &Schedule,
        completed_steps: usize,
    ) -> dpges_core::Result<()> {
        let later = |steps: &[usize]| steps.last().is_some_and(|&last| completed_steps < last);
        let [surfels] = self.max_pixels.dims();
        if surfels > 0 && later(&schedule.surfel_prune) {
            self.max_pixels = self.max_pixels.clone().max_pair(coverage(&render.layers, surfels));
        }
        if self.max_contributions.dims()[0] > 0 && later(&schedule.gaussian_prune) {
            let gaussians = gaussians.map_ref(|_, values| values.clone().inner());
            let colours = render.gaussian_colours.clone().inner();
            let limits = render.limits.clone().inner();
            let found = contributions(&gaussians, &colours, &limits, &gates(render), camera)?;
            self.max_contributions = self.max_contributions.clone().max_pair(found);
        }
        Ok(())
    }
}

/// [K, H, W] weight of each depth interval in a pixel: T_{k−1} / (1 + W_G).
fn gates(render: &Render) -> Tensor<3> {
    let [layers, height, width] = render.limits.dims();
    let transmittance = render.composite.transmittance.clone().inner().slice([0..layers, 0..height, 0..width]);
    transmittance / (render.composite.gaussian_weight.clone().inner() + 1.0)
}
