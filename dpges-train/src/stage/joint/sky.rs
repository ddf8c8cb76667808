//! What is known to be sky belongs to the environment.

use burn::tensor::{DType, Device, Tensor, TensorData};
use dpges_core::counters::transfers::upload;

use super::super::{Context, EnvironmentState};
use crate::dataset::View;
use crate::init::sky::sky_pixels;

/// Which pixels of the training views show nothing but sky, in host memory.
pub struct SkyMasks(Vec<Vec<bool>>);

impl SkyMasks {
    /// `None` in runs without an environment, and where nothing holds it free.
    pub fn new(environment: &EnvironmentState, context: &Context) -> Option<Self> {
        let is_held_free = environment.value().is_some() && context.config.train.lambda_sky > 0.0;
        is_held_free.then(|| Self(sky_pixels(&context.dataset)))
    }

    /// Sets `values` [H × W] to 0 where the training view with index `index` shows nothing but sky.
    pub fn clear(&self, index: usize, values: &mut [f32]) {
        values.iter_mut().zip(&self.0[index]).filter(|(_, is_sky)| **is_sky).for_each(|(value, _)| *value = 0.0);
    }

    /// [1, H, W] 1 where the training view with index `index` shows nothing but sky; `None` if it does so nowhere.
    pub fn of(&self, index: usize, view: &View, device: &Device) -> Option<Tensor<3>> {
        let pixels = &self.0[index];
        let values: Vec<f32> = pixels.iter().map(|&is_sky| f32::from(u8::from(is_sky))).collect();
        let data = || TensorData::new(values, [1, view.camera.height, view.camera.width]);
        (!pixels.is_empty()).then(|| Tensor::from_data(upload(data()), (device, DType::F32)))
    }
}
