//! Training of blended Gaussians: discs (2DGS), or ellipsoids that are relocated (3DGS-MCMC, DBS).

mod losses;
mod refine;
mod schedule;
mod screen_gradients;
mod start;

use burn::tensor::{DType, Device, Tensor};
use dpges_core::losses::{Losses, rgb};
use dpges_core::ops::environment::environment;
use dpges_core::ops::jitter::NoiseGate;
use dpges_core::render::blended::{BlendedOptions, render_blended};
use dpges_core::scene::{Rendering, SceneData, SceneInfo, SurfelData};

use super::{
    Context, EnvironmentState, ForwardPass, Leaves, Parameters, Stage, StageCheckpoint, StepInput, StepRates,
    TrainError, Trained,
};
use crate::config::{Config, OpacityActivation, Relocation, StagePlan};
use crate::scene_state::{GaussianState, Rates, SurfelState};
use losses::Weights;
use schedule::{BlendedDue, BlendedSchedule};
pub use screen_gradients::ScreenGradients;

/// A stage of blended Gaussians. Their opacities are trained as logits.
pub struct BlendedStage {
    pub plan: StagePlan,
    /// How Gaussians are relocated; `None` for discs, which are densified instead.
    relocation: Option<Relocation>,
    pub info: SceneInfo,
    schedule: BlendedSchedule,
    /// There are none.
    surfels: SurfelState,
    pub gaussians: GaussianState,
    pub environment: EnvironmentState,
    pub screen_gradients: ScreenGradients,
}

impl BlendedStage {
    /// A stage of discs, or of Gaussians that are relocated, before the environment that is `trained`.
    ///
    /// # Errors
    /// Those of [`begin`](super::begin).
    pub fn begin(
        plan: StagePlan,
        relocation: Option<Relocation>,
        trained: &Trained,
        context: &mut Context,
    ) -> Result<Self, TrainError> {
        let start = match relocation {
            None => context.start_of_discs(plan)?,
            Some(_) => context.start_of_gaussians(plan)?,
        };
        let device = &context.device;
        let gaussians = GaussianState::new(&start, OpacityActivation::Sigmoid, device);
        let screen_gradients = ScreenGradients::new(start.len(), device);
        let environment = EnvironmentState::new(trained.environment.as_ref(), device);
        Ok(Self::new(plan, relocation, gaussians, environment, screen_gradients, context))
    }

    /// A stage that goes on with `gaussians`, their `screen_gradients` and an `environment`.
    pub fn new(
        plan: StagePlan,
        relocation: Option<Relocation>,
        gaussians: GaussianState,
        environment: EnvironmentState,
        screen_gradients: ScreenGradients,
        context: &Context,
    ) -> Self {
        let config = &context.config;
        let rendering = if relocation.is_none() { Rendering::Discs } else { Rendering::Ellipsoids };
        Self {
            plan,
            relocation,
            info: context.scene_info(rendering),
            schedule: BlendedSchedule::new(config, plan, relocation, context.dataset.train.len()),
            surfels: SurfelState::new(
                &SurfelData::neutral(config.model.colour, 0),
                OpacityActivation::Linear,
                &context.device,
            ),
            gaussians,
            environment,
            screen_gradients,
        }
    }

    /// [M, 4] leaf whose gradient densification wants, if there is one to come.
    fn probe(&self, completed: usize, tape: &Device) -> Option<Tensor<2>> {
        let wanted = self.schedule.densify.last().is_some_and(|&last| completed < last);
        wanted.then(|| Tensor::zeros([self.gaussians.len(), 4], (tape, DType::F32)).require_grad())
    }

    fn weights(&self, completed: usize, config: &Config) -> Weights {
        match self.relocation {
            None => Weights::of_discs(&config.discs, self.plan, completed),
            Some(kind) => Weights::of_relocated(&config.relocation, kind, self.plan, completed),
        }
    }

    /// World units.
    fn position_rate(&self, completed: usize, config: &Config) -> f64 {
        let progress = completed as f64 / self.plan.steps as f64;
        let alone = config.plan().len() == 1;
        let progress = if alone { progress } else { config.stages.position_share * progress };
        config.optimizer.position_rate(progress, self.info.extent)
    }
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
        let (gaussians, environment) = (self.gaussians.to_data(), self.environment.to_data());
        SceneData { info: self.info.clone(), surfels, gaussians, environment }
    }

    fn is_due(&self, completed: usize) -> bool {
        self.schedule.due(completed) != BlendedDue::default()
    }

    fn refine(&mut self, completed: usize, context: &mut Context) -> Result<Vec<String>, TrainError> {
        self.refine_due(self.schedule.due(completed), completed, context)
    }

    fn forward(
        &mut self,
        leaves: &Leaves,
        input: &StepInput<'_>,
        context: &Context,
    ) -> dpges_core::Result<ForwardPass> {
        let (gaussians, camera) = (&leaves.gaussians, &input.view.camera);
        let tape = context.tape();
        let probe = self.probe(input.completed, &tape);
        let weights = self.weights(input.completed, &context.config);
        let mut options = BlendedOptions::new(&self.info)?;
        options.blend.maps = weights.need_maps();
        let rendered = render_blended(gaussians, probe.as_ref(), camera, &options, input.values)?;
        let rendered = match &leaves.environment {
            Some(coefficients) => rendered.in_front_of(environment(coefficients, camera)?),
            None => rendered,
        };
        let rgb = rgb(rendered.image.clone(), input.target.clone(), context.config.train.lambda_dssim)?;
        let total = weights.add(rgb.clone(), gaussians, &rendered, camera);
        let none = Tensor::zeros([1], (&tape, DType::F32));
        let losses = Losses { rgb, surfel: none.clone(), scale: none.clone(), transmittance: none, total };
        Ok(ForwardPass { losses, image: rendered.image, probe })
    }

    fn observe_probe(&mut self, gradient: Tensor<2>) {
        self.screen_gradients.add(gradient);
    }

    fn rates(&self, completed: usize, config: &Config) -> StepRates {
        let optimizer = &config.optimizer;
        let rates = Rates {
            positions: self.position_rate(completed, config),
            quaternions: optimizer.quaternions,
            log_scales: optimizer.log_scales,
            opacities: config.stages.opacities,
            base: optimizer.base,
            detail: optimizer.detail,
        };
        StepRates { surfels: rates, gaussians: rates, environment: optimizer.environment }
    }

    fn after_step(&mut self, completed: usize, context: &mut Context) -> Result<(), TrainError> {
        if self.relocation == Some(Relocation::Mcmc) {
            self.jitter(NoiseGate::Mcmc, completed, context)?;
        }
        Ok(())
    }

    fn checkpoint(&self) -> StageCheckpoint {
        StageCheckpoint::of_blended(self)
    }

    fn hand_on(&self, trained: &mut Trained) {
        trained.environment = self.environment.to_data();
        let gaussians = Some(self.gaussians.to_data());
        match self.relocation {
            None => trained.discs = gaussians,
            Some(_) => trained.gaussians = gaussians,
        }
    }
}
