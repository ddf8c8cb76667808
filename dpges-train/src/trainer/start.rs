//! What a stage begins with: points, what the stages before it have trained, or files.

use std::path::{Path, PathBuf};

use dpges_core::scene::{GaussianData, Rendering, SceneData, SurfelData};

use super::blended::BlendedStage;
use super::context::Context;
use super::joint::JointStage;
use super::supervision::Supervisions;
use super::{Stage, TrainError};
use crate::config::{Budget, GaussianStage, StageKind, StagePlan};
use crate::init::promote::promote;
use crate::init::{InitialScene, Room, initialise};
use crate::refine::margins::margins;

/// DP-GES starts from 50 to 60 % of the primitives it ends with.
const START_SHARE: f64 = 0.6;
/// Thickness of what becomes a Gaussian and was flat, over the mean of its two scales (GES).
const THICKNESS: f64 = 0.1;

const SURFELS_FROM: &str = "stages.surfels_from";
const GAUSSIANS_FROM: &str = "stages.gaussians_from";

impl Context {
    /// Whether the files that take the place of stages, and the losses, fit the plan; before the first step.
    pub fn check_given(&self, plan: &[StagePlan]) -> Result<(), TrainError> {
        self.given(SURFELS_FROM)?;
        self.given(GAUSSIANS_FROM)?;
        if self.config.refine.budget == Budget::Auto && self.dataset.validation.is_empty() {
            let needs = "refine.budget = \"auto\" needs validation views: keep some with Dataset::keep_for_validation";
            return Err(TrainError::Plan(needs.to_owned()));
        }
        let has_discs = plan.iter().any(|stage| stage.kind == StageKind::Discs)
            || self.given(SURFELS_FROM)?.is_some_and(|scene| scene.info.rendering == Rendering::Discs);
        let joint = plan.iter().any(|stage| stage.kind == StageKind::Joint);
        if joint && !has_discs {
            let needs = |what: &str| {
                TrainError::Plan(format!("{what} needs discs: set stages.surfels above 0, or stages.surfels_from"))
            };
            if self.config.train.has_geometry_losses() {
                return Err(needs("train.lambda_depth, .lambda_normal or .lambda_depth_normal"));
            }
            if self.config.stages.gaussians_by == GaussianStage::Rest {
                return Err(needs("stages.gaussians_by = \"rest\""));
            }
        }
        Ok(())
    }

    /// The scene of the file that `key` names, if it names one.
    fn given(&self, key: &'static str) -> Result<Option<SceneData>, TrainError> {
        let stages = &self.config.stages;
        let path = if key == SURFELS_FROM { &stages.surfels_from } else { &stages.gaussians_from };
        if path.is_empty() {
            return Ok(None);
        }
        let wrong = |reason: String| TrainError::Given { key, path: PathBuf::from(path), reason };
        let scene = SceneData::load(Path::new(path)).map_err(|error| wrong(error.to_string()))?;
        let (found, expected) = (scene.info.colour_model, self.config.model.colour);
        if found != expected {
            return Err(wrong(format!("its colours are {found}, those of this run are {expected} (model.colour)")));
        }
        let rendering = scene.info.rendering;
        let (fits, what) = if key == SURFELS_FROM {
            (rendering != Rendering::Ellipsoids, "surfels or discs")
        } else {
            (rendering != Rendering::Discs, "Gaussians")
        };
        if !fits {
            return Err(wrong(format!("it is a scene of {rendering}, not of {what}")));
        }
        let offset = self.dataset.offset.to_array();
        if scene.info.offset != offset {
            let found = scene.info.offset;
            return Err(wrong(format!("its origin is {found:?} in the dataset, that of this run {offset:?}")));
        }
        Ok(Some(scene))
    }

    /// The stage of `plan`, with the trained `discs` and `gaussians`, if stages before it have made any.
    pub fn begin_stage(
        &mut self,
        plan: StagePlan,
        discs: Option<&GaussianData>,
        gaussians: Option<GaussianData>,
    ) -> Result<Stage, TrainError> {
        Ok(match plan.kind {
            StageKind::Discs => {
                let start = self.start_of_discs(plan)?;
                Stage::Blended(Box::new(BlendedStage::new(self, plan, &start)))
            }
            StageKind::Gaussians(_) => {
                let start = self.start_of_gaussians(plan)?;
                Stage::Blended(Box::new(BlendedStage::new(self, plan, &start)))
            }
            StageKind::Joint => {
                let given = self.given(SURFELS_FROM)?;
                let from_file = given.as_ref().filter(|scene| scene.info.rendering == Rendering::Discs);
                let discs = discs.or(from_file.map(|scene| &scene.gaussians));
                let supervisions = match discs {
                    Some(discs) if self.config.train.has_geometry_losses() => {
                        Some(Supervisions::new(discs, &self.scene_info(Rendering::Discs), &self.dataset, &self.device)?)
                    }
                    _ => None,
                };
                let start = self.start_of_joint(given.as_ref(), discs, gaussians)?;
                Stage::Joint(Box::new(JointStage::new(self, plan, &start, supervisions)))
            }
        })
    }

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
                         (stages.surfels), or lower stages.surfel_opacity",
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
            return Err(TrainError::Plan("the stages before the joint one left neither surfels nor Gaussians".into()));
        }
        let (count, budget) = (surfels.len() + gaussians.len(), self.budget());
        if count > budget {
            tracing::warn!("{count} surfels and Gaussians were given, more than the budget of {budget}: none is added");
        }
        surfels.margins = margins(&surfels.positions, &surfels.log_scales, self.config.model.margin);
        Ok(InitialScene { surfels, gaussians })
    }

    fn start_of_discs(&mut self, plan: StagePlan) -> Result<GaussianData, TrainError> {
        let mut config = self.config.clone();
        config.init.surfel_scale = config.discs.start_scale;
        config.init.gaussian_scale = config.discs.start_scale;
        let opacity = config.discs.start_opacity as f32;
        let room = self.most_primitives(plan.budget_share) as f64;
        let start = initialise(&self.dataset, &config, Room::new(room, room), &mut self.rng)?;
        let mut discs = if start.surfels.is_empty() { start.gaussians } else { flat(start.surfels) };
        discs.opacities.fill(opacity);
        Ok(discs)
    }

    fn start_of_gaussians(&mut self, plan: StagePlan) -> Result<GaussianData, TrainError> {
        let mut config = self.config.clone();
        config.init.gaussian_scale = config.relocation.start_scale;
        config.init.gaussian_opacity = config.relocation.start_opacity;
        let room = self.most_primitives(plan.budget_share) as f64;
        Ok(initialise(&self.dataset, &config, Room::new(room, room), &mut self.rng)?.gaussians)
    }
}

/// Surfels as flat Gaussians.
fn flat(surfels: SurfelData) -> GaussianData {
    let thick = |&[x, y]: &[f32; 2]| {
        let mean = (f64::from(x).exp() + f64::from(y).exp()) / 2.0;
        [x, y, (THICKNESS * mean).ln() as f32]
    };
    let mut discs = GaussianData::neutral(surfels.colour.model, surfels.len());
    discs.log_scales = surfels.log_scales.as_chunks::<2>().0.iter().flat_map(thick).collect();
    discs.positions = surfels.positions;
    discs.quaternions = surfels.quaternions;
    discs.colour = surfels.colour;
    discs
}
