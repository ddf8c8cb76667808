//! Pixels that are known to be sky belong to the environment.

use burn::tensor::{DType, Tensor, TensorData};
use dpges_core::counters::transfers::upload;
use dpges_core::losses::{Losses, hidden};

use super::super::{Context, EnvironmentState};
use super::RenderedView;
use crate::dataset::Picture;
use crate::init::sky_detection::Skies;

/// The sky in the training views.
pub struct SkyMasks(Skies);

impl SkyMasks {
    /// `None` in runs without an environment, and where nothing holds it free.
    ///
    /// # Errors
    /// [`dpges_core::Error::Io`] if a photograph cannot be read again.
    pub fn new(environment: &EnvironmentState, context: &Context) -> dpges_core::Result<Option<Self>> {
        let is_held_free = environment.is_some() && context.config.train.lambda_sky > 0.0;
        is_held_free.then(|| Skies::new(&context.recorded()).map(Self)).transpose()
    }

    /// Sets `values` [H × W] to 0 where the training view with index `index`, of this `picture`, shows nothing but sky.
    pub fn clear(&self, index: usize, picture: &Picture, values: &mut [f32]) {
        if let Some(sky) = self.0.of(index, picture) {
            sky.pixels(picture).into_iter().for_each(|pixel| values[pixel] = 0.0);
        }
    }
}

/// Adds the share of the environment that surfels and Gaussians hide where the view shows nothing but sky.
pub fn sky(view: &RenderedView<'_>, losses: &mut Losses) -> dpges_core::Result<()> {
    let Some(SkyMasks(skies)) = &view.stage.sky else { return Ok(()) };
    let picture = view.input.view.picture()?;
    if let Some(sky) = skies.of(view.input.index, &picture) {
        let mut values = vec![0.0f32; picture.area()];
        sky.pixels(&picture).into_iter().for_each(|pixel| values[pixel] = 1.0);
        let mask = upload(TensorData::new(values, [1, picture.height, picture.width]));
        let mask = Tensor::from_data(mask, (&view.context.tape(), DType::F32));
        losses.add("sky", view.of_counted(hidden(view.rendered, mask)), view.context.config.train.lambda_sky);
    }
    Ok(())
}
