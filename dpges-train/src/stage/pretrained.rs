//! Scene files that take the place of stages, and whether a plan has what it needs.

use std::path::{Path, PathBuf};

use dpges_core::backend::device::largest_buffer;
use dpges_core::ops::blend::Form;
use dpges_core::render::room::Drawn;
use dpges_core::scene::{Rendering, SceneData};

use super::{Context, TrainError};
use crate::config::{Blended, Density, GaussianStage, StageKind, StagePlan, Stop};

/// Key of the file to take discs or surfels from.
pub const SURFELS_FROM: &str = "stages.surfels_from";
/// Key of the file to take Gaussians from.
pub const GAUSSIANS_FROM: &str = "stages.gaussians_from";

impl Context {
    /// Checks before the first step that there is all that `plan`, its losses and its decisions need.
    ///
    /// # Errors
    /// [`TrainError::Plan`] names what is missing or too large, [`TrainError::Pretrained`] a file that cannot be used.
    pub fn check_plan(&self, plan: &[StagePlan]) -> Result<(), TrainError> {
        plan.iter().try_for_each(|stage| self.check_room(stage))?;
        let surfels = self.pretrained(SURFELS_FROM)?;
        self.pretrained(GAUSSIANS_FROM)?;
        if self.config.train.stop == Stop::Validation && self.dataset.validation.is_empty() {
            return Err(TrainError::Plan(
                "train.stop = \"validation\" needs validation views, and the dataset has none: data.validation_every keeps \
                 some of the training views, of which there must be more than two"
                    .into(),
            ));
        }
        let trains = |kind: StageKind| plan.iter().any(|stage| stage.kind == kind);
        let (joint, discs) = (trains(StageKind::Joint), trains(StageKind::Blended(Blended::Discs)));
        let has_discs = discs || surfels.is_some_and(|scene| scene.info.rendering == Rendering::Discs);
        if self.config.block().is_some() && plan.iter().any(|stage| stage.kind != StageKind::Joint) {
            return Err(TrainError::Plan(
                "a block (train.block) is trained by the joint stage alone: name what it begins with in \
                 stages.surfels_from and stages.gaussians_from"
                    .into(),
            ));
        }
        let renders_discs = discs || (joint && has_discs && self.config.train.has_geometry_losses());
        let meets_rays = trains(StageKind::Blended(Blended::Controlled(Density::Hybrid)));
        // a stage is also judged by views that it does not learn from
        let mut views = self.dataset.train.iter().chain(&self.dataset.validation).chain(&self.dataset.test);
        if let Some(view) = views.find(|view| view.camera.lens.is_some() && (renders_discs || meets_rays)) {
            if meets_rays {
                return Err(TrainError::Plan(format!(
                    "Gaussians of train.method = \"htgs\" cannot be seen through a lens, and view `{}` has one: set \
                     data.undistort = true",
                    view.name
                )));
            }
            return Err(TrainError::Plan(format!(
                "discs cannot be seen through a lens, and view `{}` has one: set data.undistort = true, or train without \
                 discs (stages.surfels = 0)",
                view.name
            )));
        }
        if joint && !has_discs {
            let needs = |what: &str| {
                TrainError::Plan(format!("{what} needs discs: set stages.surfels above 0, or stages.surfels_from"))
            };
            if self.config.train.has_geometry_losses() {
                return Err(needs("train.lambda_disc_depth, .lambda_disc_normal or .lambda_disc_depth_normal"));
            }
            if self.config.stages.gaussians_by == GaussianStage::Rest {
                return Err(needs("stages.gaussians_by = \"rest\""));
            }
        }
        Ok(())
    }

    /// Whether buffers of the device hold as many primitives as `stage` may have.
    fn check_room(&self, stage: &StagePlan) -> Result<(), TrainError> {
        let joint = stage.kind == StageKind::Joint;
        let of_surfels = if joint { self.config.stages.depth_surfels } else { 0.0 };
        let of_ranks = if joint { self.ranks.count() } else { 1 };
        // every rank has all surfels, and its part of the Gaussians
        for (drawn, share, ranks) in
            [(Drawn::Surfels, of_surfels, 1), (self.drawn(stage.kind), stage.budget_share, of_ranks)]
        {
            let most = drawn.most(&self.device).saturating_mul(ranks);
            let wanted = self.budget as f64 * share;
            if wanted.is_finite() && wanted > most as f64 {
                let (wanted, bytes, fits) = (wanted as usize, largest_buffer(&self.device), most as f64 / share);
                return Err(TrainError::Plan(format!(
                    "the {} stage would hold {wanted} {}, and this device has room for {most}, since none of its buffers \
                     has more than {bytes} bytes: set refine.budget to at most {}",
                    stage.kind,
                    if drawn == Drawn::Surfels { "surfels" } else { "primitives" },
                    fits as usize
                )));
            }
        }
        Ok(())
    }

    fn drawn(&self, kind: StageKind) -> Drawn {
        match kind {
            StageKind::Joint | StageKind::Blended(Blended::Controlled(Density::Summed)) => Drawn::Summed,
            StageKind::Blended(blended) => {
                let order = blended.blend_order(self.config.density.transparency);
                let form = match blended.rendering() {
                    Rendering::Discs => Form::Discs,
                    Rendering::Students => Form::Students,
                    _ if order.transparency().is_some() => Form::Whitened,
                    _ => Form::Ellipsoids,
                };
                Drawn::Blended(form, order)
            }
        }
    }

    /// The scene in the file that `key` names, if it names one.
    ///
    /// # Errors
    /// [`TrainError::Pretrained`] if the file cannot be read, or its scene does not fit this run.
    pub fn pretrained(&self, key: &'static str) -> Result<Option<SceneData>, TrainError> {
        let stages = &self.config.stages;
        let path = if key == SURFELS_FROM { &stages.surfels_from } else { &stages.gaussians_from };
        if path.is_empty() {
            return Ok(None);
        }
        let wrong = |reason: String| TrainError::Pretrained { key, path: PathBuf::from(path), reason };
        let scene = SceneData::load(Path::new(path)).map_err(|error| wrong(error.to_string()))?;
        let (found, expected) = (scene.info.colour_model, self.config.model.colour);
        if found != expected {
            return Err(wrong(format!("its colours are {found}, those of this run are {expected} (model.colour)")));
        }
        let rendering = scene.info.rendering;
        let (fits, what) = if key == SURFELS_FROM {
            (matches!(rendering, Rendering::Peeled | Rendering::Discs), "surfels or discs")
        } else {
            (matches!(rendering, Rendering::Peeled | Rendering::Ellipsoids), "Gaussians that were blended or peeled")
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
}
