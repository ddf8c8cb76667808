//! What pruning wants to know about the views since it last happened.

use burn::tensor::Tensor;
use dpges_core::camera::Camera;
use dpges_core::ops::peel::Layers;
use dpges_core::ops::splat::contributions;
use dpges_core::render::Render;
use dpges_core::scene::tensors::tensor_to_rows;

use crate::config::Schedule;
use crate::scene_state::GaussianState;

/// Running maxima over views.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Statistics {
    /// [N] most pixels at which a surfel was the nearest in one view.
    pub max_pixels: Vec<u32>,
    /// [M] largest contribution of a Gaussian to a pixel.
    pub max_contributions: Vec<f32>,
}

impl Statistics {
    pub fn new(surfels: usize, gaussians: usize) -> Self {
        Self { max_pixels: vec![0; surfels], max_contributions: vec![0.0; gaussians] }
    }

    /// Adds one rendered view, as far as a later pruning of `schedule` still needs it.
    ///
    /// # Errors
    /// [`dpges_core::Error`] if the render belongs to other Gaussians.
    pub fn observe(
        &mut self,
        render: &Render,
        gaussians: &GaussianState,
        camera: &Camera,
        schedule: &Schedule,
        completed_steps: usize,
    ) -> dpges_core::Result<()> {
        let later = |steps: &[usize]| steps.last().is_some_and(|&last| completed_steps < last);
        if later(&schedule.surfel_prune) {
            let found = first_layer_pixels(&render.layers, self.max_pixels.len());
            for (max, count) in self.max_pixels.iter_mut().zip(found) {
                *max = (*max).max(count);
            }
        }
        if later(&schedule.gaussian_prune) {
            let colours = render.gaussian_colours.clone().inner();
            let limits = render.limits.clone().inner();
            let gates = gates(render);
            let found = tensor_to_rows(&contributions(&gaussians.values(), colours, limits, gates, camera)?);
            for (max, contribution) in self.max_contributions.iter_mut().zip(found) {
                *max = max.max(contribution);
            }
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

/// [count] pixels at which each surfel is the nearest layer.
fn first_layer_pixels(layers: &Layers, count: usize) -> Vec<u32> {
    let [_, height, width] = layers.ids.dims();
    let nearest = layers.ids.clone().slice([0..1, 0..height, 0..width]);
    let mut pixels = vec![0; count];
    for id in nearest.into_data().iter::<i64>() {
        if let Ok(id) = usize::try_from(id) {
            pixels[id] += 1;
        }
    }
    pixels
}
