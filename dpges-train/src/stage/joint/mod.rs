//! The joint optimisation of surfels and Gaussians (DP-GES).

mod automatic_budget;
mod blended_depth;
mod depth_surfels;
mod dropout;
mod limits;
mod losses;
mod measured;
mod refine;
mod schedule;
mod sharding;
mod sky_masks;
mod start;
mod statistics;
mod supervision;
mod surfel_fit;

use std::sync::Arc;

use dpges_core::camera::Camera;
use dpges_core::ranks::Ranks;
use dpges_core::render::{Render, RenderOptions, ViewRequest, render};
use dpges_core::scene::{Gaussians, Rendering, SceneData, SceneInfo, Surfels};

use super::{
    Context, EnvironmentState, ForwardPass, Leaves, Observed, Parameters, Stage, StageCheckpoint, StepInput, StepRates,
    Surroundings, TrainError, Trained, environment,
};
use crate::config::{Config, OpacityActivation, StagePlan};
use crate::init::InitialScene;
use crate::optimizer::scene_state::{GaussianState, Rates, SurfelState};
use crate::refine::growth::Growth;
use crate::refine::prune::drawn;
pub use limits::SamplingLimits;
pub use measured::MeasuredPoints;
use schedule::{Due, Schedule};
pub use sharding::{OWNERS, Sharding, in_order};
use sky_masks::SkyMasks;
pub use statistics::Statistics;
pub use supervision::Supervisions;

/// Share of the position schedule that the joint stage would take (DP-GES: 25,000 of 30,000 steps).
const JOINT: f64 = 25.0 / 30.0;

/// The stage in which surfels and Gaussians learn together.
pub struct JointStage {
    pub plan: StagePlan,
    pub info: SceneInfo,
    pub schedule: Schedule,
    pub surfels: SurfelState,
    pub gaussians: GaussianState,
    pub sharding: Sharding,
    pub environment: EnvironmentState,
    /// Factor on the losses that hold down Gaussians which few pictures need.
    pub held_down: f64,
    /// `None` if primitives may be as fine as they like.
    pub limits: Option<SamplingLimits>,
    /// `None` if nothing holds the sky free.
    pub sky: Option<SkyMasks>,
    /// `None` if nothing holds surfels to points.
    pub measured: Option<MeasuredPoints>,
    pub statistics: Statistics,
    /// Targets of the geometry losses; `None` without them.
    pub supervisions: Option<Supervisions>,
    /// Growth decisions of an automatic budget; `None` before the first, and with a fixed budget.
    pub growth: Option<Growth>,
    /// `None` unless the run trains a block.
    pub surroundings: Option<Arc<Surroundings>>,
}

/// The factor [`JointStage::held_down`] of a run, 0 to 1: 1 with an environment, 0 on a background that is given, where objects
/// lose fine detail by these losses, and less in longer runs of all others.
fn held_down(environment: &EnvironmentState, context: &Context) -> f64 {
    match environment {
        Some(_) => 1.0,
        None if context.background_is_given() => 0.0,
        // a doll gains 0.3 dB in 46 passes, and loses 0.7 dB in 238
        None => 1.0 - dropout::length(&context.config.train, context.dataset.train.len()),
    }
}

/// A training view that the stage has rendered.
pub struct RenderedView<'a> {
    stage: &'a JointStage,
    context: &'a Context,
    input: &'a StepInput<'a>,
    rendered: &'a Render,
    /// All that it was rendered from, those of the stage first.
    surfels: &'a Surfels,
    /// Those of the stage, on the tape.
    own_surfels: &'a Surfels,
    own_gaussians: &'a Gaussians,
}

impl JointStage {
    fn new(
        plan: StagePlan,
        start: &InitialScene,
        environment: EnvironmentState,
        supervisions: Option<Supervisions>,
        context: &Context,
    ) -> dpges_core::Result<Self> {
        let device = &context.device;
        let surfels = SurfelState::new(&start.surfels, OpacityActivation::Linear, device);
        let sharding = Sharding::new(start.gaussians.len(), context.ranks.clone());
        let own = start.gaussians.select(&sharding.own());
        let gaussians = GaussianState::new(&own, context.config.model.opacity, device);
        let limits = SamplingLimits::new(&surfels, &gaussians, context);
        let stage = Self::of_states(plan, surfels, gaussians, sharding, environment, context)?;
        Ok(Self { limits, supervisions, ..stage })
    }

    /// A stage of which nothing has been observed, without limits or geometry losses.
    ///
    /// # Errors
    /// [`dpges_core::Error::Io`] if a photograph cannot be read again.
    pub fn of_states(
        plan: StagePlan,
        surfels: SurfelState,
        gaussians: GaussianState,
        sharding: Sharding,
        environment: EnvironmentState,
        context: &Context,
    ) -> dpges_core::Result<Self> {
        Ok(Self {
            plan,
            info: context.scene_info(Rendering::Peeled),
            schedule: Schedule::new(&context.config, plan.steps, context.dataset.train.len()),
            measured: MeasuredPoints::new(&surfels.columns.positions.raw(), context),
            statistics: Statistics::new(surfels.len(), gaussians.len(), &context.device),
            surfels,
            gaussians,
            sharding,
            limits: None,
            held_down: held_down(&environment, context),
            sky: SkyMasks::new(&environment, context)?,
            environment,
            supervisions: None,
            growth: None,
            surroundings: context.surroundings.clone(),
        })
    }

    /// A stage that begins with `scene` as it is, without geometry losses.
    ///
    /// # Errors
    /// [`dpges_core::Error::Io`] if a photograph cannot be read again.
    pub fn of_scene(plan: StagePlan, scene: &SceneData, context: &Context) -> dpges_core::Result<Self> {
        let start = InitialScene { surfels: scene.surfels.clone(), gaussians: scene.gaussians.clone() };
        let environment = environment::fresh(scene.environment.as_ref(), &context.device);
        Self::new(plan, &start, environment, None, context)
    }

    /// Leaves out Gaussians, see [`dropout`].
    fn drop_out(&self, gaussians: &mut Gaussians, completed: usize, context: &Context) {
        let train = &context.config.train;
        let share = dropout::share(train, context.dataset.train.len());
        if share > 0.0 {
            let factors = dropout::factors(&self.sharding, share, train.seed, completed, &gaussians.opacities.device());
            gaussians.opacities = gaussians.opacities.clone() * factors;
        }
    }

    fn render_options(&self, config: &Config) -> RenderOptions {
        RenderOptions { detach_transmittance: config.train.detach_transmittance, ..RenderOptions::from(&self.info) }
    }
}

impl Stage for JointStage {
    fn plan(&self) -> StagePlan {
        self.plan
    }

    fn parameters(&mut self) -> Parameters<'_> {
        Parameters {
            surfels: &mut self.surfels,
            gaussians: &mut self.gaussians,
            environment: &mut self.environment,
            weighted_sum: None,
        }
    }

    /// Leaves out Gaussians that draw nothing.
    fn scene(&self) -> SceneData {
        let gaussians = self.sharding.all_data(self.drawn_gaussian_data());
        // an opacity below 1/255 shows in no picture, and only takes space
        let gaussians = gaussians.select(&drawn(&gaussians.opacities));
        let (surfels, environment) = (self.drawn_surfel_data(), environment::to_data(&self.environment));
        SceneData { info: self.info.clone(), surfels, gaussians, environment }
    }

    fn ranks(&self) -> Arc<dyn Ranks> {
        self.sharding.ranks.clone()
    }

    fn gaussian_count(&mut self) -> usize {
        self.sharding.len()
    }

    fn is_due(&self, completed: usize) -> bool {
        self.schedule.due(completed) != Due::default()
    }

    fn refine(&mut self, completed: usize, context: &mut Context) -> Result<Vec<String>, TrainError> {
        self.refine_due(self.schedule.due(completed), context)
    }

    fn forward(&self, leaves: &Leaves, input: &StepInput<'_>, context: &Context) -> dpges_core::Result<ForwardPass> {
        let own_surfels = &self.drawn_surfels(&leaves.surfels);
        let mut own_gaussians = self.drawn_gaussians(&leaves.gaussians);
        // indoors and on objects leaving out gained nothing
        if leaves.environment.is_some() {
            self.drop_out(&mut own_gaussians, input.completed, context);
        }
        let own_gaussians = &own_gaussians;
        let all = self.surroundings.as_ref().map(|around| around.on_tape(own_surfels, own_gaussians));
        let (surfels, gaussians) = all.as_ref().map_or((own_surfels, own_gaussians), |all| (&all.0, &all.1));
        let request = ViewRequest { ranks: &*self.sharding.ranks, ..input.request() };
        let rendered = render(surfels, gaussians, request, &self.render_options(&context.config))?;
        let mut rendered = input.environment(&leaves.environment)?.into_iter().fold(rendered, Render::in_front_of);
        // last, since an exposure belongs to the photograph, environment included, and not to the scene
        rendered.composite.image = input.photographed(rendered.composite.image);
        rendered.composite.surfel_image = input.photographed(rendered.composite.surfel_image);
        let view =
            RenderedView { stage: self, context, input, rendered: &rendered, surfels, own_surfels, own_gaussians };
        // on a clone: a pass is repeated if a list had no room, and must be idempotent
        let mut statistics = self.statistics.clone();
        statistics.observe(&view)?;
        Ok(ForwardPass { losses: view.losses()?, probe: None, statistics: Some(statistics) })
    }

    fn observe(&mut self, observed: Observed, _: &[Camera]) {
        self.statistics = observed.statistics.expect("this stage has statistics");
    }

    fn looks_at_pictures(&self) -> bool {
        self.sky.is_some()
    }

    fn rates(&self, completed: usize, config: &Config) -> StepRates {
        let optimizer = &config.optimizer;
        let progress = completed as f64 / self.plan.steps as f64;
        let travelled =
            if config.joins_trained(&self.plan) { config.stages.position_share + JOINT * progress } else { progress };
        let (position, decay) = (optimizer.position_rate(travelled, self.info.extent), optimizer.decay_at(progress));
        let gaussians = Rates {
            // faster positions, rotations and scales gained in this stage; faster colours and opacities did not
            positions: optimizer.joint_geometry * position,
            quaternions: optimizer.joint_geometry * optimizer.quaternions * decay,
            log_scales: optimizer.joint_geometry * optimizer.log_scales * decay,
            opacities: optimizer.opacities * decay,
            base: optimizer.base * decay,
            detail: optimizer.detail * decay,
            ..Rates::default()
        };
        let surfels = if config.train.freeze_surfels { gaussians.of_colours() } else { gaussians };
        // what is behind everything is that of all blocks
        let is_given = self.surroundings.as_ref().is_some_and(|around| around.scene.environment.is_some());
        let environment = if is_given { 0.0 } else { optimizer.environment * decay };
        StepRates { surfels, gaussians, environment, ..StepRates::default() }
    }

    fn after_step(&mut self, completed: usize, _: &mut Context) -> Result<(), TrainError> {
        if let Some(measured) = self.measured.as_mut().filter(|_| MeasuredPoints::is_due(completed)) {
            measured.measure(&self.surfels.columns.positions.raw());
        }
        Ok(())
    }

    fn checkpoint(&self) -> StageCheckpoint {
        StageCheckpoint::of_joint(self)
    }

    fn finish(&self, trained: &mut Trained) {
        let SceneData { surfels, gaussians, environment, .. } = self.scene();
        (trained.joined, trained.environment) = (Some(InitialScene { surfels, gaussians }), environment);
    }
}
