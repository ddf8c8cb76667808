//! A scene that learns to look like other pictures, without primitives that come or go.

use burn::tensor::Device;
use dpges_core::scene::SceneData;
use dpges_core::scene::schema::OpacityActivation;

use super::own_pictures::{StepStage, config, dataset, last_stage};
use super::{StepReport, TrainError};
use crate::dataset::View;
use crate::stage::{self, StepViews, begin_step};

/// Trains the primitives of `scene`, a peeled one, for `steps` steps of the joint stage on `views`. None comes or goes, each
/// stays in its row, and the environment stays as it is. The image alone is learnt from: at the learning rates of the default
/// configuration, without the terms that shape a scene which is still to be found.
pub fn refit(scene: &SceneData, views: &[View], steps: usize, device: &Device) -> Result<SceneData, TrainError> {
    let mut config = config(scene, StepStage::Joint);
    config.train.steps = steps;
    config.model.opacity = OpacityActivation::Linear;
    config.optimizer.environment = 0.0;
    let train = &mut config.train;
    for term in [
        &mut train.lambda_surfel,
        &mut train.lambda_scale,
        &mut train.lambda_transmittance,
        &mut train.lambda_sky,
        &mut train.lambda_opacity,
        &mut train.lambda_gaussian_scale,
    ] {
        *term = 0.0;
    }
    let (plan, mut context) = last_stage(config, dataset(&scene.info, views.to_vec()), 0.0, device);
    let mut stage = stage::of_scene(plan, scene, &context)?;
    for step in 1..=steps {
        let view = context.next_view();
        let report = StepReport::begin(step, plan, view, Vec::new());
        let begun = begin_step(&mut *stage, &mut context, report, StepViews::one(view))?;
        begun.learn(&mut *stage, &mut context)?.settle()?;
        context.completed_steps += 1;
    }
    let parameters = stage.parameters();
    Ok(SceneData {
        surfels: parameters.surfels.to_data(),
        gaussians: parameters.gaussians.to_data(),
        info: scene.info.clone(),
        environment: scene.environment.clone(),
    })
}
