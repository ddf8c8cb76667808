//! Training of blended Gaussians: discs (2DGS), or ellipsoids that are cloned and split (3DGS) or relocated (3DGS-MCMC,
//! DBS).

mod losses;
mod refine;
mod schedule;
mod screen_gradients;
mod start;

use burn::tensor::{DType, Device, Tensor};
use dpges_core::camera::Camera;
use dpges_core::losses::geometry::expected_depth;
use dpges_core::losses::{Losses, rgb_and_error};
use dpges_core::ops::jitter::NoiseGate;
use dpges_core::ops::photometric::Photometric;
use dpges_core::render::blended::{BlendedOptions, Probes, render_blended_probed};
use dpges_core::scene::tensors::rows_to_tensor;
use dpges_core::scene::{ColourModel, GaussianData, Gaussians, SH_C0, SceneData, SceneInfo, SurfelData};

use super::sampling_limit::SamplingLimit;
use super::{
    Context, EnvironmentState, ForwardPass, Leaves, Observed, Parameters, Stage, StageCheckpoint, StepInput, StepRates,
    TrainError, Trained,
};
use crate::config::{Blended, Config, Density, OpacityActivation, Relocation, StagePlan};
use crate::optimizer::LOGIT_RATE;
use crate::optimizer::scene_state::{GaussianState, Rates, SurfelState};
use losses::Weights;
use schedule::{BlendedDue, BlendedSchedule};
pub use screen_gradients::ScreenGradients;

/// Base colour that is black without detail: 0.5 + C₀ k = 0.
const BLACK: f64 = -0.5 / SH_C0;
/// Interval at which harmonics of another degree begin to learn, steps (3DGS).
const DEGREE_EVERY: usize = 1000;

/// A stage of blended Gaussians. Their opacities are trained as logits.
pub struct BlendedStage {
    pub plan: StagePlan,
    blended: Blended,
    pub info: SceneInfo,
    schedule: BlendedSchedule,
    /// There are none.
    surfels: SurfelState,
    pub gaussians: GaussianState,
    pub environment: EnvironmentState,
    pub screen_gradients: ScreenGradients,
    /// Gradients before the last step, if there was one.
    gradients_before: Option<ScreenGradients>,
    /// [M, 3] positions before the jitter of the last step, if it had any.
    positions_before: Option<Tensor<2>>,
    /// `None` without a filter in the world.
    pub sampling_limit: Option<SamplingLimit>,
}

impl BlendedStage {
    /// A stage of discs or of Gaussians, before the environment that is `trained`.
    ///
    /// # Errors
    /// The errors of [`begin`](super::begin).
    pub fn begin(
        plan: StagePlan,
        blended: Blended,
        trained: &Trained,
        context: &mut Context,
    ) -> Result<Self, TrainError> {
        let start = match blended {
            Blended::Discs => context.start_of_discs(plan)?,
            Blended::Controlled(_) | Blended::Relocated(_) => context.start_of_gaussians(plan, blended)?,
        };
        let device = &context.device;
        let gaussians = GaussianState::new(&start, OpacityActivation::Sigmoid, device);
        let screen_gradients = ScreenGradients::new(start.len(), device);
        let environment = EnvironmentState::new(trained.environment.as_ref(), device);
        let smooths = blended == Blended::Controlled(Density::Smoothed);
        let smoothing_px = context.config.mip_splatting_px();
        let positions = gaussians.columns.positions.raw();
        let sampling_limit = smooths.then(|| SamplingLimit::new(&positions, smoothing_px, context));
        Ok(Self { sampling_limit, ..Self::new(plan, blended, gaussians, environment, screen_gradients, context) })
    }

    /// A stage that goes on with `gaussians`, their `screen_gradients` and an `environment`, without a sampling limit.
    pub fn new(
        plan: StagePlan,
        blended: Blended,
        gaussians: GaussianState,
        environment: EnvironmentState,
        screen_gradients: ScreenGradients,
        context: &Context,
    ) -> Self {
        let config = &context.config;
        Self {
            plan,
            blended,
            info: SceneInfo { screen_filter: blended.screen_filter(), ..context.scene_info(blended.rendering()) },
            schedule: BlendedSchedule::new(plan, blended, context.dataset.train.len()),
            surfels: SurfelState::new(
                &SurfelData::neutral(config.model.colour, 0),
                OpacityActivation::Linear,
                &context.device,
            ),
            gaussians,
            environment,
            screen_gradients,
            gradients_before: None,
            positions_before: None,
            sampling_limit: None,
        }
    }

    /// A stage that begins with the Gaussians and the environment of `scene` as they are, without a sampling limit.
    pub fn of_scene(plan: StagePlan, blended: Blended, scene: &SceneData, context: &Context) -> Self {
        let device = &context.device;
        let gaussians = GaussianState::new(&scene.gaussians, OpacityActivation::Sigmoid, device);
        let environment = EnvironmentState::new(scene.environment.as_ref(), device);
        let screen_gradients = ScreenGradients::new(scene.gaussians.len(), device);
        Self::new(plan, blended, gaussians, environment, screen_gradients, context)
    }

    /// The Gaussians as they are drawn, wherever they come from: with their sampling limit, and without base colours below
    /// black, which count as black as long as they are blended (DBS).
    fn drawn(&self) -> GaussianData {
        let mut gaussians = self.gaussians.to_data();
        if let Some(limit) = &self.sampling_limit {
            limit.bake(&mut gaussians);
        }
        if let ColourModel::SphericalBeta { .. } = self.info.colour_model {
            gaussians.colour.base.iter_mut().for_each(|base| *base = base.max(BLACK as f32));
        }
        gaussians
    }

    /// The Gaussians that a step draws.
    fn drawn_on_tape(&self, gaussians: &Gaussians, completed: usize, tape: &Device) -> Gaussians {
        let mut gaussians = match &self.sampling_limit {
            Some(limit) => limit.smoothed(gaussians),
            None => gaussians.clone(),
        };
        match self.info.colour_model {
            ColourModel::SphericalBeta { .. } => {
                gaussians.colour.base = gaussians.colour.base.clamp_min(BLACK);
            }
            ColourModel::SphericalHarmonics { degree } => {
                let learning = self.degree(completed);
                let (of, all) = (ColourModel::SphericalHarmonics { degree: learning }.detail_len(), degree);
                if learning < all {
                    let mask = (0..self.info.colour_model.detail_len()).map(|at| f32::from(u8::from(at < of)));
                    let mask: Vec<f32> = mask.collect();
                    gaussians.colour.detail =
                        gaussians.colour.detail * rows_to_tensor(&mask, mask.len(), tape, DType::F32);
                }
            }
        }
        gaussians
    }

    /// The degree up to which harmonics learn.
    fn degree(&self, completed: usize) -> usize {
        let interval = match self.blended {
            Blended::Controlled(_) => self.plan.scaled(DEGREE_EVERY),
            Blended::Discs | Blended::Relocated(_) => 0,
        };
        completed.checked_div(interval).unwrap_or(usize::MAX)
    }

    /// Forgets what was observed of Gaussians that are no longer the same.
    fn restart_observations(&mut self, context: &Context) {
        self.screen_gradients = ScreenGradients::new(self.gaussians.len(), &context.device);
        if let Some(limit) = &mut self.sampling_limit {
            limit.measure(&self.gaussians.columns.positions.raw(), context);
        }
    }

    /// [M, 4] leaf whose gradient densification wants, if there is one to come.
    fn probe(&self, completed: usize, tape: &Device) -> Option<Tensor<2>> {
        let wanted = self.schedule.densify.last().is_some_and(|&last| completed < last);
        wanted.then(|| Tensor::zeros([self.gaussians.len(), 4], (tape, DType::F32)).require_grad())
    }

    fn weights(&self, completed: usize, config: &Config) -> Weights {
        match self.blended {
            Blended::Discs => Weights::of_discs(&config.discs, self.plan, completed),
            Blended::Controlled(_) => Weights::default(),
            Blended::Relocated(kind) => Weights::of_relocated(&config.relocation, kind, self.plan, completed),
        }
    }

    /// World units.
    fn position_rate(&self, completed: usize, config: &Config) -> f64 {
        let progress = completed as f64 / self.plan.steps as f64;
        let progress = if is_alone(config) { progress } else { config.stages.position_share * progress };
        config.optimizer.position_rate(progress, self.info.extent)
    }
}

/// Whether a stage of blended primitives is the whole run.
fn is_alone(config: &Config) -> bool {
    config.plan().len() == 1
}

impl Stage for BlendedStage {
    fn plan(&self) -> StagePlan {
        self.plan
    }

    fn parameters(&mut self) -> Parameters<'_> {
        Parameters { surfels: &mut self.surfels, gaussians: &mut self.gaussians, environment: &mut self.environment }
    }

    fn scene(&self) -> SceneData {
        let surfels = SurfelData::neutral(self.info.colour_model, 0);
        let (gaussians, environment) = (self.drawn(), self.environment.to_data());
        SceneData { info: self.info.clone(), surfels, gaussians, environment }
    }

    fn is_due(&self, completed: usize) -> bool {
        self.schedule.due(completed) != BlendedDue::default()
    }

    fn refine(&mut self, completed: usize, context: &mut Context) -> Result<Vec<String>, TrainError> {
        self.refine_due(self.schedule.due(completed), completed, context)
    }

    fn forward(&self, leaves: &Leaves, input: &StepInput<'_>, context: &Context) -> dpges_core::Result<ForwardPass> {
        let camera = &input.view.camera;
        let tape = context.tape();
        let probe = self.probe(input.completed, &tape);
        let gaussians = &self.drawn_on_tape(&leaves.gaussians, input.completed, &tape);
        let weights = self.weights(input.completed, &context.config);
        let mut options = BlendedOptions::new(&self.info)?;
        options.blend.maps = weights.need_maps() || input.depth.is_some();
        let probes = Probes { gaussians: probe.as_ref(), pose: input.pose };
        let rendered = render_blended_probed(gaussians, probes, camera, &options, input.values)?;
        let mut rendered = match &leaves.environment {
            Some(coefficients) => rendered.in_front_of(input.environment(coefficients)?),
            None => rendered,
        };
        rendered.image = input.photographed(rendered.image);
        let share = context.config.train.lambda_dssim;
        let Photometric { value: rgb, squared_error } = rgb_and_error(&rendered.image, &input.target, share)?;
        let mut total = weights.add(rgb.clone(), gaussians, &rendered, camera, input.target.mask.as_ref());
        if let (Some(target), Some(maps)) = (&input.depth, &rendered.blend.maps) {
            let alpha = rendered.blend.alpha.clone();
            total = total + target.loss(expected_depth(maps.depth.clone(), alpha.clone()), alpha)?;
        }
        let none = Tensor::zeros([1], (&tape, DType::F32));
        let [surfel, scale] = [none.clone(), none.clone()];
        let losses = Losses { rgb, surfel, scale, transmittance: none, total, squared_error };
        Ok(ForwardPass { losses, probe, statistics: None })
    }

    fn observe(&mut self, observed: Observed, camera: &Camera) {
        self.gradients_before = None;
        if let Some(gradient) = observed.of_probe {
            self.gradients_before = Some(self.screen_gradients.clone());
            let axes = if self.blended == Blended::Discs { 2 } else { 3 };
            self.screen_gradients.see(&self.gaussians.values(), axes, camera);
            self.screen_gradients.add(gradient);
        }
    }

    fn rates(&self, completed: usize, config: &Config) -> StepRates {
        let optimizer = &config.optimizer;
        let decay = if is_alone(config) { optimizer.decay_at(completed as f64 / self.plan.steps as f64) } else { 1.0 };
        let rates = Rates {
            positions: self.position_rate(completed, config),
            quaternions: optimizer.quaternions * decay,
            log_scales: optimizer.log_scales * decay,
            opacities: LOGIT_RATE * decay,
            base: optimizer.base * decay,
            detail: optimizer.detail * decay,
        };
        StepRates { surfels: rates, gaussians: rates, environment: optimizer.environment * decay }
    }

    fn after_step(&mut self, completed: usize, context: &mut Context) -> Result<(), TrainError> {
        if self.blended == Blended::Relocated(Relocation::Mcmc) {
            self.positions_before = Some(self.gaussians.columns.positions.raw());
            self.jitter(NoiseGate::Mcmc, completed, context)?;
        }
        Ok(())
    }

    fn undo(&mut self) {
        if let Some(gradients) = self.gradients_before.take() {
            self.screen_gradients = gradients;
        }
        if let Some(positions) = self.positions_before.take() {
            self.gaussians.columns.positions.set_tensor(positions);
        }
    }

    fn checkpoint(&self) -> StageCheckpoint {
        StageCheckpoint::of_blended(self)
    }

    fn hand_on(&self, trained: &mut Trained) {
        trained.environment = self.environment.to_data();
        let gaussians = Some(self.drawn());
        match self.blended {
            Blended::Discs => trained.discs = gaussians,
            Blended::Controlled(_) | Blended::Relocated(_) => trained.gaussians = gaussians,
        }
    }
}
