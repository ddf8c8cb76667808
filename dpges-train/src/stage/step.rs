//! One step of any stage: render, compare, go back, optimise.

use burn::tensor::Tensor;
use dpges_core::losses::Target;
use dpges_core::ops::environment::environment;
use dpges_core::render::Values;
use dpges_core::render::pose::PoseProbe;
use dpges_core::within_capacity;

use super::depth::DepthTarget;
use super::exposure::photographed;
use super::pending::{PendingStep, StepGate};
use super::poses::POSES;
use super::{Context, Stage, StepReport, TrainError};
use crate::dataset::View;

/// What a step learns from.
pub struct StepInput<'a> {
    /// Steps of the stage that are done.
    pub completed: usize,
    /// Index of the training view.
    pub index: usize,
    pub view: &'a View,
    /// Its photograph, on the device of the tape.
    pub target: Target,
    /// What is known of the parameters.
    pub values: Values,
    /// What a depth map says of the view; `None` if it has none.
    pub depth: Option<DepthTarget>,
    /// [1, 6] the colour correction of the view, on the tape; `None` in runs without any.
    pub exposure: Option<Tensor<2>>,
    /// What the gradient of the pose of the view arrives at; `None` if poses are not refined.
    pub pose: Option<&'a PoseProbe>,
}

impl StepInput<'_> {
    /// A rendered `image` [3, H, W] with the exposure of the photograph.
    pub fn photographed(&self, image: Tensor<3>) -> Tensor<3> {
        match &self.exposure {
            Some(correction) => photographed(image, correction),
            None => image,
        }
    }

    /// The environment [3, H, W] with `coefficients` [(degree + 1)², 3] behind the view.
    ///
    /// # Errors
    /// Those of [`environment`].
    pub fn environment(&self, coefficients: &Tensor<2>) -> dpges_core::Result<Tensor<3>> {
        match self.pose {
            Some(probe) => environment(&probe.environment(coefficients), &self.view.camera),
            None => environment(coefficients, &self.view.camera),
        }
    }
}

/// Hands everything of one step to the device, and does not wait for it.
///
/// # Errors
/// [`TrainError::Step`] if the parameters or the view are not what the operations expect, [`TrainError::Core`] if its
/// photograph cannot be read again.
pub fn begin_step(
    stage: &mut dyn Stage,
    context: &mut Context,
    mut report: StepReport,
) -> Result<PendingStep, TrainError> {
    let completed = context.completed_in(stage.plan());
    let dataset = context.dataset.clone();
    let view = &dataset.train[report.view];

    let parameters = stage.parameters();
    (report.surfels, report.gaussians) = (parameters.surfels.len(), parameters.gaussians.len());
    let leaves = parameters.leaves();
    let target = context.target(report.view)?;
    context.read_ahead(stage);
    // After the first step they stay finite, since a step with a gradient that is not finite is held back
    let values = if completed == 0 { Values::Unknown } else { Values::KnownFinite };
    let depth = context.depth_target(report.view, &context.tape());
    let corrections = context.exposure.leaf();
    let exposure = corrections.as_ref().map(|leaf| leaf.clone().slice([report.view..report.view + 1, 0..6]));
    let index = report.view;
    let probe = context.pose_probe(index);
    let pose = probe.as_ref();
    let input = StepInput { completed, index, view, target, values, depth, exposure, pose };
    let at = |source| TrainError::Step { step: report.step, view: view.name.clone(), source };
    let forward = within_capacity(|| stage.forward(&leaves, &input, context)).flatten().map_err(at)?;

    let mut gradients = within_capacity(|| forward.losses.total.backward()).map_err(at)?;
    let found = stage.parameters().gradients(&leaves, &mut gradients);
    if let Some(gradient) = forward.probe.and_then(|probe| probe.grad_remove(&mut gradients)) {
        stage.observe_probe(gradient);
    }
    let of_exposure = context.exposure.gradient(corrections.as_ref(), &mut gradients);
    let of_pose = probe.as_ref().and_then(|probe| probe.gradient(&mut gradients));
    let attributes = found.iter().chain(&of_exposure);
    let attributes = attributes.filter_map(|(attribute, gradient)| Some((attribute.raw_name, gradient.as_ref()?)));
    let gate =
        StepGate::new(&forward.losses.total, attributes.chain(of_pose.as_ref().map(|gradient| (POSES, gradient))));
    let pending = PendingStep::new(report, view.name.clone(), forward.losses, of_pose, &gate);
    // The tape shares the parameters: without it the optimiser can work in place
    drop((leaves, corrections, probe));

    let rates = stage.rates(completed, &context.config);
    stage.parameters().step(found, gate.open(), &rates, &context.config.optimizer.adam(completed))?;
    context.step_exposure(of_exposure, gate.open())?;
    stage.after_step(completed, context)?;
    Ok(pending)
}
