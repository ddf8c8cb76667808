//! One step of any stage: render, compare, go back, optimise.

use burn::tensor::{DType, Tensor};
use dpges_core::camera::Camera;
use dpges_core::losses::{Losses, Target};
use dpges_core::ops::environment::environment;
use dpges_core::render::pose::PoseProbe;
use dpges_core::render::{Values, ViewRequest};
use dpges_core::tiles::lists;
use dpges_core::within_capacity;

use super::parameters::ParameterGradients;
use super::pending::{PendingStep, StepGate};
use super::{Context, Observed, Stage, StepReport, TrainError};
use crate::dataset::View;
use crate::optimizer::{NamedGradient, Parameter};
use crate::views::depth::DepthTarget;
use crate::views::exposure::state::{self, photographed};
use crate::views::pose::refinement::POSES;

#[derive(Clone, Debug, PartialEq, Eq)]
pub struct StepViews {
    /// Index of a view for each rank, or of one for all of them.
    pub of_ranks: Vec<usize>,
    /// Index of the view of this rank.
    pub own: usize,
}

impl StepViews {
    /// The same view on all ranks.
    pub fn one(view: usize) -> Self {
        Self { of_ranks: vec![view], own: view }
    }
}

#[derive(Clone)]
pub struct StepInput<'a> {
    /// Steps of the stage that are done.
    pub completed: usize,
    pub index: usize,
    pub view: &'a View,
    /// Its photograph, on the device of the tape.
    pub target: Target,
    /// Whether the parameters are known to be finite.
    pub values: Values,
    /// The depth map of the view; `None` if it has none.
    pub depth: Option<DepthTarget>,
    /// [1, 6] the colour correction of the view, on the tape; `None` in runs without any.
    pub exposure: Option<Tensor<2>>,
    /// Receives the gradient of the pose of the view; `None` if poses are not refined.
    pub pose: Option<&'a PoseProbe>,
}

impl StepInput<'_> {
    pub fn request(&self) -> ViewRequest<'_> {
        ViewRequest { values: self.values, pose: self.pose, ..(&self.view.camera).into() }
    }

    /// A rendered `image` [3, H, W] with the exposure of the photograph.
    pub fn photographed(&self, image: Tensor<3>) -> Tensor<3> {
        match &self.exposure {
            Some(correction) => photographed(image, correction),
            None => image,
        }
    }

    /// The environment [3, H, W] behind the view, if it has `coefficients` [(degree + 1)², 3].
    pub fn environment(&self, coefficients: &Option<Tensor<2>>) -> dpges_core::Result<Option<Tensor<3>>> {
        let Some(coefficients) = coefficients else { return Ok(None) };
        let moved = self.pose.map(|probe| probe.environment(coefficients));
        environment(moved.as_ref().unwrap_or(coefficients), &self.view.camera).map(Some)
    }
}

/// The results of a view for the parameters, all of it on the device. Nothing has learnt from it yet.
struct Pass {
    losses: Losses,
    of_parameters: ParameterGradients,
    /// `None` in runs without corrections.
    of_exposure: Option<NamedGradient>,
    /// [V, 6] for the views of the step; `None` if poses are not refined.
    of_pose: Option<Tensor<2>>,
    observed: Observed,
    gate: StepGate,
}

impl Pass {
    /// Goes forward and back, on as many views as the stage has in a step. `given` lacks what begins on the tape of this pass:
    /// exposure and pose.
    fn new(stage: &mut dyn Stage, context: &Context, given: &StepInput<'_>) -> dpges_core::Result<Self> {
        let leaves = stage.parameters().leaves();
        let corrections = context.exposure.as_ref().map(Parameter::leaf);
        let exposure = corrections.as_ref().map(|leaf| leaf.clone().slice([given.index..given.index + 1, 0..6]));
        let ranks = stage.ranks();
        let moved = |probe: PoseProbe| if ranks.is_first() { probe } else { probe.of_gaussians() };
        let probe = context.pose_probe(given.index).map(moved);
        let input = StepInput { exposure, pose: probe.as_ref(), ..given.clone() };
        let forward = within_capacity(|| stage.forward(&leaves, &input, context)).flatten()?;

        let mut gradients = within_capacity(|| forward.losses.total.backward())?;
        let mut of_parameters = stage.parameters().gradients(&leaves, &mut gradients);
        let with_leaf = context.exposure.as_ref().zip(corrections.as_ref());
        let mut of_exposure = with_leaf.map(|(parameter, leaf)| parameter.gradient(leaf, &mut gradients));
        let mut of_pose = probe.as_ref().and_then(|probe| probe.gradient(&mut gradients));
        let views = stage.views_per_step();
        if views > 1 {
            let mean = |gradient: Tensor<2>| context.ranks.joined(gradient) / views as f64;
            of_parameters = of_parameters.map(mean);
            of_exposure = of_exposure.map(|(attribute, gradient)| (attribute, gradient.map(mean)));
        }
        if probe.is_some() && !context.ranks.is_alone() {
            let nothing = |rows: usize| Tensor::zeros([rows, 6], (&context.device, DType::F32));
            let own = of_pose.unwrap_or_else(|| nothing(1));
            let (before, after) =
                if views > 1 { (context.ranks.rank(), views - 1 - context.ranks.rank()) } else { (0, 0) };
            let rows = [nothing(before), own, nothing(after)].into_iter().filter(|rows| rows.dims()[0] > 0);
            of_pose = Some(context.ranks.joined(Tensor::cat(rows.collect(), 0)));
        }
        let of_probe = forward.probe.and_then(|probe| probe.grad_remove(&mut gradients));
        let attributes = of_parameters.iter().chain(&of_exposure);
        let attributes = attributes.filter_map(|(attribute, gradient)| Some((attribute.raw_name, gradient.as_ref()?)));
        let gate = StepGate::new(
            &forward.losses.total,
            attributes.chain(of_pose.as_ref().map(|gradient| (POSES, gradient))),
            &*context.ranks,
        );
        let observed = Observed { statistics: forward.statistics, of_probe };
        Ok(Self { losses: forward.losses, of_parameters, of_exposure, of_pose, observed, gate })
    }
}

/// A step whose forward and backward pass are handed to the device. Nothing has learnt from them yet.
pub struct BegunStep {
    report: StepReport,
    view_name: String,
    views: StepViews,
    cameras: Vec<Camera>,
    /// Steps of the stage that are done.
    completed: usize,
    pass: Pass,
}

/// Hands the first half of a step on `views` to the device, and waits for nothing but the lengths of its tile lists. A GPU knows
/// these after the numbers of the step before.
///
/// # Errors
/// [`TrainError::Step`] if the parameters or the view are not what the operations expect, [`TrainError::Core`] if its
/// photograph cannot be read again.
pub fn begin_step(
    stage: &mut dyn Stage,
    context: &mut Context,
    mut report: StepReport,
    views: StepViews,
) -> Result<BegunStep, TrainError> {
    let completed = context.completed_in(stage.plan());
    let dataset = context.dataset.clone();
    let view = &dataset.train[views.own];
    let cameras = views.of_ranks.iter().map(|&view| dataset.train[view].camera).collect();

    (report.surfels, report.gaussians) = (stage.parameters().surfels.len(), stage.gaussian_count());
    let target = context.target(views.own)?;
    context.prefetch(stage);
    // After the first step they stay finite, since a step with a gradient that is not finite is held back
    let values = if completed == 0 { Values::Unknown } else { Values::KnownFinite };
    let depth = context.depth_target(report.view, &context.tape());
    let given = StepInput { completed, index: views.own, view, target, values, depth, exposure: None, pose: None };
    let at = |source| TrainError::Step { step: report.step, view: view.name.clone(), source };
    let pass = if context.ranks.is_alone() {
        // twice if a list had no room: a pass changes nothing
        lists::defer_readback(|| Pass::new(stage, context, &given))
    } else {
        // other ranks would not go with this one a second time
        Pass::new(stage, context, &given)
    };
    let pass = pass.map_err(at)?;
    Ok(BegunStep { report, view_name: view.name.clone(), views, cameras, completed, pass })
}

impl BegunStep {
    /// Hands the other half to the device, in which parameters learn, and waits for nothing.
    pub fn learn(self, stage: &mut dyn Stage, context: &mut Context) -> Result<PendingStep, TrainError> {
        let Self { report, view_name, views, cameras, completed, pass } = self;
        let Pass { losses, of_parameters, of_exposure, of_pose, observed, gate } = pass;
        let pending = PendingStep::new(report, view_name, views, losses, of_pose, &gate);
        stage.observe(observed, &cameras);
        let rates = stage.rates(completed, &context.config);
        let batch = stage.views_per_step();
        let adam = context.config.optimizer.adam(completed, batch);
        stage.parameters().step(of_parameters, gate.open(), &rates, adam)?;
        let step = context.exposure_step(batch);
        state::step(&mut context.exposure, of_exposure, gate.open(), step)?;
        stage.after_step(completed, context)?;
        Ok(pending)
    }
}
