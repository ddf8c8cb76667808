//! The joint optimisation of surfels and Gaussians (DP-GES): one view per step.

use dpges_core::losses::geometry::{GeometryWeights, geometry};
use dpges_core::losses::{LossWeights, losses};
use dpges_core::ops::splat::SplatOptions;
use dpges_core::render::{RenderOptions, Values, render_values};
use dpges_core::scene::{Rendering, SceneData, SceneInfo};

use super::context::Context;
use super::pending::{Gate, PendingStep};
use super::statistics::Statistics;
use super::supervision::Supervisions;
use super::{StepReport, TrainError};
use crate::config::{Config, Due, OpacityActivation, Schedule, StagePlan};
use crate::init::InitialScene;
use crate::refine::growth::Growth;
use crate::refine::prune::drawn;
use crate::scene_state::{GaussianState, Leaves, Rates, SurfelState};

/// Share of the position schedule that the joint stage would take (DP-GES: 25,000 of 30,000 steps).
const JOINT: f64 = 25.0 / 30.0;

/// The stage in which surfels and Gaussians learn together.
pub struct JointStage {
    pub plan: StagePlan,
    pub info: SceneInfo,
    pub schedule: Schedule,
    pub surfels: SurfelState,
    pub gaussians: GaussianState,
    pub statistics: Statistics,
    /// Of the geometry losses; `None` without them.
    pub supervisions: Option<Supervisions>,
    /// Of an automatic budget.
    pub growth: Option<Growth>,
}

impl JointStage {
    pub fn new(context: &Context, plan: StagePlan, start: &InitialScene, supervisions: Option<Supervisions>) -> Self {
        let (config, device) = (&context.config, &context.device);
        Self {
            plan,
            info: context.scene_info(Rendering::Peeled),
            schedule: config.schedule(context.dataset.train.len()),
            surfels: SurfelState::new(&start.surfels, OpacityActivation::Linear, device),
            gaussians: GaussianState::new(&start.gaussians, config.model.opacity, device),
            statistics: Statistics::new(start.surfels.len(), start.gaussians.len(), device),
            supervisions,
            growth: None,
        }
    }

    /// Without the Gaussians that draw nothing.
    pub fn scene(&self) -> SceneData {
        let gaussians = self.gaussians.to_data();
        let gaussians = gaussians.select(&drawn(&gaussians.opacities).keep);
        SceneData { info: self.info.clone(), surfels: self.surfels.to_data(), gaussians }
    }

    /// What is due after `completed` steps of this stage.
    pub fn due(&self, completed: usize) -> Due {
        self.schedule.due(completed)
    }

    /// Hands everything of one step to the device.
    pub fn begin_step(&mut self, context: &mut Context, mut report: StepReport) -> Result<PendingStep, TrainError> {
        let completed = context.completed_steps - self.plan.begin;
        (report.surfels, report.gaussians) = (self.surfels.len(), self.gaussians.len());
        let dataset = context.dataset.clone();
        let view = &dataset.train[report.view];
        let at = |source| TrainError::Step { step: report.step, view: view.name.clone(), source };

        let Leaves { values: surfels, raw: raw_surfels } = self.surfels.leaves();
        let Leaves { values: gaussians, raw: raw_gaussians } = self.gaussians.leaves();
        let target = view.target(&context.device.clone().autodiff());
        // afterwards they stay finite, since steps with a gradient that is not are held back
        let known = if completed == 0 { Values::Unknown } else { Values::KnownFinite };
        let options = self.render_options(&context.config);
        let rendered = render_values(&surfels, &gaussians, &view.camera, &options, known).map_err(at)?;
        let weights = loss_weights(&context.config);
        let terms = losses(&rendered, surfels.log_scales.clone(), target.clone(), &weights).map_err(at)?;
        let mut total = terms.total.clone();
        if let Some(supervisions) = &self.supervisions {
            let supervision = supervisions.of(report.view, &context.device.clone().autodiff());
            let weights = geometry_weights(&context.config);
            total = total + geometry(&rendered, &surfels, &view.camera, &supervision, &weights).map_err(at)?;
        }

        let mut gradients = total.backward();
        let surfel_gradients = self.surfels.gradients(&raw_surfels, &mut gradients);
        let gaussian_gradients = self.gaussians.gradients(&raw_gaussians, &mut gradients);
        let gate = Gate::new(&total, surfel_gradients.iter().chain(&gaussian_gradients));
        let numbers =
            [total, terms.rgb.clone(), terms.surfel.clone(), terms.scale.clone(), terms.transmittance.clone()];
        let image = rendered.composite.image.clone();
        let pending = PendingStep::new(report, view.name.clone(), numbers, image, target, &gate);
        self.statistics.observe(&rendered, &self.gaussians, &view.camera, &self.schedule, completed)?;
        // the tape shares the parameters: without it the optimiser can work in place
        drop((surfels, raw_surfels, gaussians, raw_gaussians, rendered, terms));

        let rates = self.rates(&context.config, completed);
        let adam = context.config.optimizer.adam(completed);
        let positions = rates.positions * context.config.optimizer.surfel_position_factor;
        let surfel_rates = Rates { positions, ..rates };
        let surfel_rates = if context.config.train.freeze_surfels { surfel_rates.of_colours() } else { surfel_rates };
        self.surfels.step(surfel_gradients, &gate.open, &surfel_rates, adam)?;
        self.gaussians.step(gaussian_gradients, &gate.open, &rates, adam)?;
        Ok(pending)
    }

    pub fn render_options(&self, config: &Config) -> RenderOptions {
        RenderOptions {
            splat: SplatOptions { deterministic: config.train.deterministic },
            detach_transmittance: config.train.detach_transmittance,
            ..RenderOptions::from(&self.info)
        }
    }

    /// Learning rates of the Gaussians for the step after `completed` ones.
    fn rates(&self, config: &Config, completed: usize) -> Rates {
        let optimizer = &config.optimizer;
        let progress = completed as f64 / self.plan.steps as f64;
        let travelled = if config.joins_trained() { config.stages.position_share + JOINT * progress } else { progress };
        let (position, decay) = (optimizer.position_rate(travelled, self.info.extent), optimizer.decay_at(progress));
        Rates {
            positions: position,
            quaternions: optimizer.quaternions * decay,
            log_scales: optimizer.log_scales * decay,
            opacities: optimizer.opacities * decay,
            base: optimizer.base * decay,
            detail: optimizer.detail * decay,
        }
    }
}

fn loss_weights(config: &Config) -> LossWeights {
    let train = &config.train;
    LossWeights {
        dssim: train.lambda_dssim,
        surfel: train.lambda_surfel,
        scale: train.lambda_scale,
        transmittance: train.lambda_transmittance,
    }
}

fn geometry_weights(config: &Config) -> GeometryWeights {
    let train = &config.train;
    GeometryWeights { depth: train.lambda_depth, normal: train.lambda_normal, depth_normal: train.lambda_depth_normal }
}
