//! Training of blended Gaussians: discs (2DGS), or ellipsoids that are cloned and split (3DGS) or relocated (3DGS-MCMC,
//! DBS, SSS). Ellipsoids may also be summed in any order, not blended (weighted sums).

mod losses;
mod momenta;
mod refine;
mod schedule;
mod screen_gradients;
mod start;

use std::sync::Arc;

use burn::tensor::{DType, Device, Tensor};
use dpges_core::camera::Camera;
use dpges_core::losses::geometry::expected_depth;
use dpges_core::losses::rgb;
use dpges_core::ops::jitter::NoiseGate;
use dpges_core::ranks::Ranks;
use dpges_core::render::ViewRequest;
use dpges_core::render::blended::{BlendedOptions, BlendedRender, render_blended};
use dpges_core::render::summed::{SummedOptions, SummedRender, render_summed};
use dpges_core::scene::tensors::rows_to_tensor;
use dpges_core::scene::{
    ColourModel, EnvironmentData, GaussianData, Gaussians, Rendering, SH_C0, SceneData, SceneInfo, SurfelData,
    WeightedSum,
};
use rand::RngExt;

use super::sampling_limit::SamplingLimit;
use super::{
    Context, EnvironmentState, ForwardPass, Leaves, Observed, Parameters, Stage, StageCheckpoint, StepInput, StepRates,
    TrainError, Trained, WeightedSumState, environment, weighted_sum,
};
use crate::config::{Blended, Config, Density, OpacityActivation, Relocation, StagePlan};
use crate::optimizer::scene_state::{GaussianState, Rates, SurfelState};
use crate::optimizer::{LOGIT_RATE, unit_of};
use losses::Weights;
pub use momenta::Momenta;
use momenta::MomentumStep;
use schedule::{BlendedDue, BlendedSchedule};
pub use screen_gradients::ScreenGradients;

/// Base colour that is black without detail: 0.5 + C₀ k = 0.
const BLACK: f64 = -0.5 / SH_C0;
/// Interval at which harmonics of another degree begin to learn, steps (3DGS).
const DEGREE_EVERY: usize = 1000;
/// Learning rate of opacities before tanh (SSS).
const TANH_RATE: f64 = 5e-3;
/// Learning rate of logits of opacities that have a factor by direction (weighted sums).
const SUMMED_RATE: f64 = 0.01;
/// Learning rate of the zeroth coefficient of that factor, and that of the higher ones as a share of it, as of colours (3DGS).
const FACTOR_RATE: f64 = 0.05;
const HIGHER_FACTORS: f64 = 1.0 / 20.0;

/// Learning rate of degrees of freedom, and the steps of a run of 30,000 after which it halves (SSS).
const DEGREES_RATE: f64 = 10.0;
const DEGREES_HALVED_EVERY: usize = 5000;

/// A stage of blended Gaussians. Their opacities are trained through [`Blended::opacity`].
pub struct BlendedStage {
    pub plan: StagePlan,
    blended: Blended,
    /// The ranks, each of which has a view of its own in every step.
    ranks: Arc<dyn Ranks>,
    pub info: SceneInfo,
    schedule: BlendedSchedule,
    /// Always empty.
    surfels: SurfelState,
    pub gaussians: GaussianState,
    pub environment: EnvironmentState,
    pub screen_gradients: ScreenGradients,
    /// `None` without a filter in the world.
    pub sampling_limit: Option<SamplingLimit>,
    /// Momenta of positions; `None` where Adam moves them.
    pub momenta: Option<Momenta>,
    /// `None` unless Gaussians are summed.
    pub weighted_sum: Option<WeightedSumState>,
}

impl BlendedStage {
    /// A stage of discs or of Gaussians, before the environment that is `trained`.
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
        let mut stage = Self::of_gaussians(plan, blended, &start, trained.environment.as_ref(), context);
        let (positions, smoothing_px) = (stage.gaussians.columns.positions.raw(), context.config.mip_splatting_px());
        stage.sampling_limit = blended.smooths().then(|| SamplingLimit::new(&positions, smoothing_px, context));
        let weight = context.config.weighted_sum.weight;
        let sum =
            (blended.rendering() == Rendering::Summed).then(|| weighted_sum::start(weight, context.dataset.extent));
        Ok(stage.summing(sum, context))
    }

    /// A stage that begins with these, without a sampling limit or a weighted sum.
    fn of_gaussians(
        plan: StagePlan,
        blended: Blended,
        gaussians: &GaussianData,
        environment: Option<&EnvironmentData>,
        context: &Context,
    ) -> Self {
        let device = &context.device;
        let state = GaussianState::new(gaussians, blended.opacity(), device);
        let screen_gradients = ScreenGradients::new(gaussians.len(), device);
        Self::new(plan, blended, state, environment::fresh(environment, device), screen_gradients, context)
    }

    /// This stage, with Gaussians that are summed as `sum` says; `None` if they are not.
    fn summing(mut self, sum: Option<WeightedSum>, context: &Context) -> Self {
        self.weighted_sum = sum.as_ref().map(|sum| WeightedSumState::new(sum, &context.device));
        self.info.weighted_sum = sum;
        self
    }

    /// A stage that goes on with `gaussians`, their `screen_gradients` and an `environment`, without a sampling limit or a
    /// weighted sum.
    pub fn new(
        plan: StagePlan,
        blended: Blended,
        gaussians: GaussianState,
        environment: EnvironmentState,
        screen_gradients: ScreenGradients,
        context: &Context,
    ) -> Self {
        let config = &context.config;
        let has_momenta = blended == Blended::Relocated(Relocation::Student);
        let momenta = has_momenta.then(|| Momenta::at_rest(gaussians.len(), &context.device));
        Self {
            plan,
            blended,
            ranks: Arc::clone(&context.ranks),
            info: SceneInfo {
                screen_filter: blended.screen_filter(),
                blend_order: blended.blend_order(config.density.transparency),
                colour_model: blended.colour_model(config.model.colour),
                ..context.scene_info(blended.rendering())
            },
            schedule: BlendedSchedule::new(plan, blended, context.dataset.train.len()),
            surfels: SurfelState::new(
                &SurfelData::neutral(config.model.colour, 0),
                OpacityActivation::Linear,
                &context.device,
            ),
            gaussians,
            environment,
            screen_gradients,
            sampling_limit: None,
            momenta,
            weighted_sum: None,
        }
    }

    /// A stage that begins with the Gaussians and the environment of `scene` as they are, without a sampling limit.
    pub fn of_scene(plan: StagePlan, blended: Blended, scene: &SceneData, context: &Context) -> Self {
        let stage = Self::of_gaussians(plan, blended, &scene.gaussians, scene.environment.as_ref(), context);
        stage.summing(scene.info.weighted_sum.clone(), context)
    }

    /// The info of its scenes as it stands.
    pub fn scene_info(&self) -> SceneInfo {
        let weighted_sum = self.weighted_sum.as_ref().map(WeightedSumState::to_data);
        SceneInfo { weighted_sum, ..self.info.clone() }
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

    fn drawn_on_tape(&self, gaussians: &Gaussians, completed: usize, tape: &Device) -> Gaussians {
        let mut gaussians = match &self.sampling_limit {
            Some(limit) => limit.smoothed(gaussians),
            None => gaussians.clone(),
        };
        match self.info.colour_model {
            ColourModel::SphericalBeta { .. } => gaussians.colour.base = gaussians.colour.base.clamp_min(BLACK),
            ColourModel::SphericalHarmonics { degree } | ColourModel::HarmonicsAndOpacity { degree } => {
                let learning = self.degree(completed);
                if learning < degree {
                    let of = ColourModel::HarmonicsAndOpacity { degree: learning };
                    let mut left = of.detail_len();
                    for detail in gaussians.colour.details_mut() {
                        let [_, width] = detail.dims();
                        *detail = first(detail.clone(), left, tape);
                        left = left.saturating_sub(width);
                    }
                    if self.weighted_sum.is_some() {
                        gaussians.opacity_detail = first(gaussians.opacity_detail, of.opacity_len() - 1, tape);
                    }
                }
            }
        }
        gaussians
    }

    /// The degree up to which harmonics learn.
    fn degree(&self, completed: usize) -> usize {
        let interval = match self.blended {
            Blended::Controlled(_) | Blended::Relocated(Relocation::Student) => self.plan.scaled(DEGREE_EVERY),
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
            Blended::Relocated(kind) => {
                Weights::of_relocated(&config.relocation, kind, self.plan, completed, self.info.extent)
            }
        }
    }

    /// Learning rate of the numbers that opacities are made of.
    fn opacity_rate(&self) -> f64 {
        match self.blended.rendering() {
            Rendering::Students => TANH_RATE,
            Rendering::Summed => SUMMED_RATE,
            Rendering::Peeled | Rendering::Ellipsoids | Rendering::Discs => LOGIT_RATE,
        }
    }

    /// Factor on learning rates: the root of the number of views of a step (Grendel-GS).
    fn batch_factor(&self) -> f64 {
        (self.views_per_step() as f64).sqrt()
    }

    /// World units.
    fn position_rate(&self, completed: usize, config: &Config) -> f64 {
        let progress = completed as f64 / self.plan.steps as f64;
        let progress = if is_alone(config) { progress } else { config.stages.position_share * progress };
        config.optimizer.position_rate(progress, self.info.extent) * self.batch_factor()
    }

    /// Takes the step of the momenta after `completed` ones, and moves the positions by it.
    fn move_by_momenta(&mut self, completed: usize, context: &mut Context) -> Result<(), TrainError> {
        let unit = unit_of(self.info.extent);
        let rate = (self.position_rate(completed, &context.config) / unit).sqrt();
        let students = &context.config.students;
        let burn_in_steps = self.plan.scaled(students.burn_in);
        let burns_in = completed < burn_in_steps;
        let step = MomentumStep {
            unit,
            rate,
            burns_in,
            friction: if burns_in { students.burn_in_friction } else { students.friction },
            restarts: (burn_in_steps..burn_in_steps + self.views_per_step()).contains(&completed),
            seed: context.rng.random(),
        };
        let adam = context.config.optimizer.adam(completed, self.views_per_step());
        let gaussians = self.gaussians.values();
        let Some(momenta) = &mut self.momenta else { return Ok(()) };
        let positions = momenta.step(&self.gaussians.columns.positions, &gaussians, &adam, &step)?;
        self.gaussians.columns.positions.set_tensor(positions);
        Ok(())
    }
}

/// The first `count` columns of `values`, and zeros in place of the others.
fn first(values: Tensor<2>, count: usize, tape: &Device) -> Tensor<2> {
    let [_, width] = values.dims();
    let mask: Vec<f32> = (0..width).map(|at| f32::from(u8::from(at < count))).collect();
    values * rows_to_tensor(&mask, width, tape, DType::F32)
}

/// Whether a stage of blended primitives is the whole run.
fn is_alone(config: &Config) -> bool {
    config.train.method.alone().is_some()
}

impl Stage for BlendedStage {
    fn plan(&self) -> StagePlan {
        self.plan
    }

    fn parameters(&mut self) -> Parameters<'_> {
        Parameters {
            surfels: &mut self.surfels,
            gaussians: &mut self.gaussians,
            environment: &mut self.environment,
            weighted_sum: self.weighted_sum.as_mut(),
        }
    }

    fn scene(&self) -> SceneData {
        let surfels = SurfelData::neutral(self.info.colour_model, 0);
        let (gaussians, environment) = (self.drawn(), environment::to_data(&self.environment));
        SceneData { info: self.scene_info(), surfels, gaussians, environment }
    }

    fn views_per_step(&self) -> usize {
        self.ranks.count()
    }

    fn is_due(&self, completed: usize) -> bool {
        self.schedule.due(completed, self.views_per_step()) != BlendedDue::default()
    }

    fn refine(&mut self, completed: usize, context: &mut Context) -> Result<Vec<String>, TrainError> {
        self.refine_due(self.schedule.due(completed, self.views_per_step()), completed, context)
    }

    fn forward(&self, leaves: &Leaves, input: &StepInput<'_>, context: &Context) -> dpges_core::Result<ForwardPass> {
        let tape = context.tape();
        let probe = self.probe(input.completed, &tape);
        let gaussians = &self.drawn_on_tape(&leaves.gaussians, input.completed, &tape);
        let weights = self.weights(input.completed, &context.config);
        let environment = input.environment(&leaves.environment)?;
        let share = context.config.train.lambda_dssim;
        let compare = |image: Tensor<3>| rgb(&input.photographed(image), input.target.clone(), share);
        let (mut losses, depth, alpha) = if let Some(common) = &leaves.weighted_sum {
            let options = SummedOptions { depth: input.depth.is_some(), ..SummedOptions::new(&self.info)? };
            let probe = probe.as_ref().map(|probe| probe.clone().slice([0..gaussians.len(), 0..2]));
            let request = ViewRequest { probe: probe.as_ref(), ..input.request() };
            let rendered = render_summed(gaussians, common, request, &options)?;
            let rendered = environment.into_iter().fold(rendered, SummedRender::in_front_of);
            (compare(rendered.image)?, rendered.depth, rendered.alpha)
        } else {
            let mut options = BlendedOptions::new(&self.info)?;
            options.blend.maps = weights.need_maps() || input.depth.is_some();
            let request = ViewRequest { probe: probe.as_ref(), ..input.request() };
            let rendered = render_blended(gaussians, request, &options)?;
            let rendered = environment.into_iter().fold(rendered, BlendedRender::in_front_of);
            let mut losses = compare(rendered.image.clone())?;
            weights.add_to(&mut losses, gaussians, &rendered, input);
            (losses, rendered.blend.maps.map(|maps| maps.depth), rendered.blend.alpha)
        };
        if let (Some(target), Some(depth)) = (&input.depth, depth) {
            losses.add("depth", target.loss(expected_depth(depth, alpha.clone()), alpha)?, target.weight);
        }
        Ok(ForwardPass { losses, probe, statistics: None })
    }

    fn observe(&mut self, observed: Observed, cameras: &[Camera]) {
        if let Some(gradient) = observed.of_probe {
            let axes = if self.blended == Blended::Discs { 2 } else { 3 };
            let gaussians = self.gaussians.values();
            cameras.iter().for_each(|camera| self.screen_gradients.see(&gaussians, axes, camera));
            let signed = if self.blended == Blended::Controlled(Density::Hybrid) { 3 } else { 2 };
            self.screen_gradients.add(gradient, signed, &*self.ranks);
        }
    }

    fn rates(&self, completed: usize, config: &Config) -> StepRates {
        let optimizer = &config.optimizer;
        let progress = completed as f64 / self.plan.steps as f64;
        let batch = self.batch_factor();
        let decay = batch * if is_alone(config) { optimizer.decay_at(progress) } else { 1.0 };
        let halvings = completed / self.plan.scaled(DEGREES_HALVED_EVERY).max(1);
        let rates = Rates {
            // momenta move them
            positions: if self.momenta.is_some() { 0.0 } else { self.position_rate(completed, config) },
            quaternions: optimizer.quaternions * decay,
            log_scales: optimizer.log_scales * decay,
            opacities: self.opacity_rate() * decay,
            degrees_of_freedom: batch * DEGREES_RATE * 0.5f64.powi(halvings as i32),
            opacity_base: FACTOR_RATE * decay,
            opacity_detail: HIGHER_FACTORS * FACTOR_RATE * decay,
            base: optimizer.base * decay,
            detail: optimizer.detail * decay,
        };
        let weighted_sum = self.weighted_sum.as_ref().map_or([0.0; 3], |sum| sum.rates(progress, self.info.extent));
        let weighted_sum = weighted_sum.map(|rate| rate * batch);
        StepRates { surfels: rates, gaussians: rates, environment: optimizer.environment * decay, weighted_sum }
    }

    fn after_step(&mut self, completed: usize, context: &mut Context) -> Result<(), TrainError> {
        if self.blended == Blended::Relocated(Relocation::Mcmc) {
            self.jitter(NoiseGate::Mcmc, completed, context)?;
        }
        if self.momenta.is_some() && !self.gaussians.is_empty() {
            self.move_by_momenta(completed, context)?;
        }
        Ok(())
    }

    fn checkpoint(&self) -> StageCheckpoint {
        StageCheckpoint::of_blended(self)
    }

    fn finish(&self, trained: &mut Trained) {
        trained.environment = environment::to_data(&self.environment);
        let gaussians = Some(self.drawn());
        match self.blended {
            Blended::Discs => trained.discs = gaussians,
            Blended::Controlled(_) | Blended::Relocated(_) => trained.gaussians = gaussians,
        }
    }
}
