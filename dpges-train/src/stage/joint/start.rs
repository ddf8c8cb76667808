//! What the joint stage begins with: trained discs and Gaussians, files, or the points of the dataset.

use dpges_core::scene::{GaussianData, Rendering, SceneData};

use super::super::given::{GAUSSIANS_FROM, SURFELS_FROM};
use super::super::{Context, EnvironmentState, TrainError, Trained};
use super::{JointStage, Supervisions};
use crate::config::{GaussianStage, StagePlan};
use crate::init::promote::promote;
use crate::init::{InitialScene, Room, initialise};
use crate::refine::margins::margins;

/// DP-GES starts from 50 to 60 % of the primitives it ends with.
const START_SHARE: f64 = 0.6;

impl JointStage {
    /// The stage of `plan`, with the discs and Gaussians that are `trained`.
    ///
    /// # Errors
    /// Those of [`begin`](super::super::begin).
    pub fn begin(plan: StagePlan, trained: Trained, context: &mut Context) -> Result<Self, TrainError> {
        let given = context.given(SURFELS_FROM)?;
        let from_file = given.as_ref().filter(|scene| scene.info.rendering == Rendering::Discs);
        let discs = trained.discs.as_ref().or(from_file.map(|scene| &scene.gaussians));
        let supervisions = match discs {
            Some(discs) if context.config.train.has_geometry_losses() => Some(Supervisions::new(discs, context)?),
            _ => None,
        };
        let start = context.start_of_joint(given.as_ref(), discs, trained.gaussians)?;
        let environment = EnvironmentState::new(trained.environment.as_ref(), &context.device);
        Ok(Self::new(plan, &start, environment, supervisions, context))
    }
}

impl Context {
    /// Surfels and Gaussians of the joint stage, with margins.
    fn start_of_joint(
        &mut self,
        given: Option<&SceneData>,
        discs: Option<&GaussianData>,
        gaussians: Option<GaussianData>,
    ) -> Result<InitialScene, TrainError> {
        let stages = self.config.stages.clone();
        let (mut surfels, rest) = match (discs, given) {
            (Some(discs), _) => {
                let (surfels, rest) = promote(discs, stages.surfel_opacity, stages.surfel_scale);
                tracing::info!("{} of {} discs become surfels", surfels.len(), discs.len());
                if surfels.is_empty() {
                    tracing::warn!(
                        "no disc is more opaque than {}, so there are no surfels: train longer, give discs a larger share \
                         of the steps (stages.surfels), or lower stages.surfel_opacity",
                        stages.surfel_opacity
                    );
                }
                (Some(surfels), Some(rest))
            }
            (None, Some(scene)) => (Some(scene.surfels.clone()), None),
            (None, None) => (None, None),
        };
        let mut gaussians = match (gaussians, stages.gaussians_by) {
            (Some(gaussians), _) => Some(gaussians),
            (None, GaussianStage::Rest) => rest,
            (None, _) => self.given(GAUSSIANS_FROM)?.map(|scene| scene.gaussians),
        };
        if surfels.is_none() || gaussians.is_none() {
            let budget = self.budget() as f64;
            let room = Room::new(budget * START_SHARE / 2.0, budget * START_SHARE);
            let start = initialise(&self.dataset, &self.config, room, &mut self.rng)?;
            surfels.get_or_insert(start.surfels);
            gaussians.get_or_insert(start.gaussians);
        }
        let (mut surfels, gaussians) = (surfels.unwrap_or_default(), gaussians.unwrap_or_default());
        if surfels.is_empty() && gaussians.is_empty() {
            return Err(TrainError::Plan("the joint stage has neither surfels nor Gaussians to begin with".into()));
        }
        let (count, budget) = (surfels.len() + gaussians.len(), self.budget());
        if count > budget {
            tracing::warn!("the stage begins with {count} primitives, more than its budget of {budget}: none is added");
        }
        surfels.margins = margins(&surfels.positions, &surfels.log_scales, self.config.model.margin);
        Ok(InitialScene { surfels, gaussians })
    }
}
