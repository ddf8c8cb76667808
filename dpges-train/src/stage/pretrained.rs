//! Scene files that take the place of stages, and whether a plan has what it needs.

use std::path::{Path, PathBuf};

use dpges_core::backend::device::largest_buffer;
use dpges_core::ops::blend::Form;
use dpges_core::render::room::Drawn;
use dpges_core::scene::{ColourData, ColourModel, GaussianData, Rendering, SceneData, SceneInfo, SurfelData};
use dpges_render::export::{MAX_DEGREE, Opened, flatten, open, to_harmonics};
use glam::{DVec3, Vec3};

use super::{Context, TrainError};
use crate::config::stages::COARSE_FROM;
use crate::config::{Blended, Density, GaussianStage, Relocation, StageKind, StagePlan, Stop};

/// Key of the file to take discs or surfels from.
pub const SURFELS_FROM: &str = "stages.surfels_from";
/// Key of the file to take Gaussians from.
pub const GAUSSIANS_FROM: &str = "stages.gaussians_from";
/// Most primitives of such a file that are looked up in the training views.
const MOST_LOOKED_UP: usize = 10_000;

impl Context {
    /// Checks before the first step that there is all that `plan`, its losses and its decisions need.
    ///
    /// # Errors
    /// [`TrainError::Plan`] names what is missing or too large, [`TrainError::Pretrained`] a file that cannot be used.
    pub fn check_plan(&self, plan: &[StagePlan]) -> Result<(), TrainError> {
        plan.iter().try_for_each(|stage| self.check_room(stage))?;
        self.say_what_is_lost()?;
        let surfels = self.pretrained(SURFELS_FROM)?;
        if self.config.train.stop == Stop::Validation && self.dataset.validation.is_empty() {
            return Err(TrainError::Plan(
                "train.stop = \"validation\" needs validation views, and the dataset has none: data.validation_every keeps \
                 some of the training views, of which there must be more than two"
                    .into(),
            ));
        }
        if self.config.stages.coarse > 0.0 && !plan.iter().any(|stage| stage.is_coarse) {
            tracing::info!(
                "stages.coarse has no effect: it needs photographs of {COARSE_FROM} px, method dpges, no discs or files to begin with, \
                 and an end between that of stages.gaussians and that of the run"
            );
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
        if joint && self.config.train.lambda_points > 0.0 && self.dataset.points.positions.is_empty() {
            return Err(TrainError::Plan(
                "train.lambda_points holds surfels to points, and the dataset has none: name a file of measured ones \
                 (--points, data.points)"
                    .into(),
            ));
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

    /// The scene in the file that `key` names, if it names one, in the coordinates and with the colour model of this run. It may
    /// be one of splats.
    ///
    /// # Errors
    /// [`TrainError::Pretrained`] if the file cannot be read, or its scene does not fit this run.
    pub fn pretrained(&self, key: &'static str) -> Result<Option<SceneData>, TrainError> {
        Ok(self.given(key)?.map(|Opened { scene, .. }| {
            let model = self.config.model.colour;
            let SceneData { info, surfels, gaussians, environment } = scene.relocated(self.dataset.offset.to_array());
            SceneData {
                surfels: SurfelData { colour: recoloured(&surfels.colour, model), ..surfels },
                gaussians: GaussianData { colour: recoloured(&gaussians.colour, model), ..gaussians },
                info: SceneInfo { colour_model: model, ..info },
                environment,
            }
        }))
    }

    /// Metres per world unit, if a scene that the run begins with says so.
    ///
    /// # Errors
    /// As [`pretrained`](Self::pretrained).
    pub fn given_scale(&self) -> Result<Option<f64>, TrainError> {
        let of = |key| self.given(key).map(|given| given.and_then(|Opened { scene, .. }| scene.info.metres_per_unit));
        Ok(of(SURFELS_FROM)?.or(of(GAUSSIANS_FROM)?))
    }

    fn given_path(&self, key: &str) -> &str {
        let stages = &self.config.stages;
        if key == SURFELS_FROM { &stages.surfels_from } else { &stages.gaussians_from }
    }

    /// The scene in the file that `key` names, as it is there.
    fn given(&self, key: &'static str) -> Result<Option<Opened>, TrainError> {
        let path = self.given_path(key);
        if path.is_empty() {
            return Ok(None);
        }
        let wrong = |reason: String| TrainError::Pretrained { key, path: PathBuf::from(path), reason };
        let method = self.config.train.method.alone();
        let refused = match (key, method) {
            (SURFELS_FROM, Some(blended)) if blended != Blended::Discs => {
                Some("Gaussians alone: --init-gaussians names them")
            }
            (GAUSSIANS_FROM, Some(Blended::Discs)) => Some("discs alone: --init-surfels names them"),
            (GAUSSIANS_FROM, Some(Blended::Controlled(Density::Summed))) => {
                Some("Gaussians whose weights no other scene has: it begins with the points of the dataset")
            }
            _ => None,
        };
        if let Some(what) = refused {
            let option = if key == SURFELS_FROM { "--init-surfels" } else { "--init-gaussians" };
            return Err(wrong(format!("{option} does not go with this method, which trains {what}")));
        }
        let opened = open(Path::new(path)).map_err(|error| wrong(error.to_string()))?;
        let (rendering, students) =
            (opened.scene.info.rendering, method == Some(Blended::Relocated(Relocation::Student)));
        let (fits, what) = match (key, rendering) {
            (SURFELS_FROM, found) => (matches!(found, Rendering::Peeled | Rendering::Discs), "surfels or discs"),
            (_, Rendering::Students) => (students, "Gaussians"),
            (_, Rendering::Discs) => (method.is_some(), "Gaussians that were blended or peeled"),
            (_, found) => (found != Rendering::Summed, "Gaussians that were blended or peeled"),
        };
        if fits { Ok(Some(opened)) } else { Err(wrong(format!("it is a scene of {rendering}, not of {what}"))) }
    }

    /// Refuses the `scene` of `key` if no training view shows anything of it: it is probably in other coordinates.
    fn check_is_seen(&self, key: &'static str, scene: SceneData) -> Result<(), TrainError> {
        let SceneData { surfels, gaussians, .. } = scene.relocated(self.dataset.offset.to_array());
        let positions = [surfels.positions, gaussians.positions].concat();
        let positions = positions.as_chunks::<3>().0;
        let mut sample = positions.iter().step_by(positions.len().div_ceil(MOST_LOOKED_UP).max(1)).peekable();
        let is_seen = |at: &[f32; 3]| {
            let at = Vec3::from_array(*at).as_dvec3();
            self.dataset.train.iter().any(|view| view.camera.pixel(at).is_some())
        };
        if sample.peek().is_none() || sample.any(is_seen) {
            return Ok(());
        }
        let along = |axis: usize| {
            let of_axis = positions.iter().map(|at| at[axis]);
            let (low, high) =
                (of_axis.clone().fold(f32::INFINITY, f32::min), of_axis.fold(f32::NEG_INFINITY, f32::max));
            format!("{} {low:.3} to {high:.3}", ["x", "y", "z"][axis])
        };
        let [x, y, z] = [0, 1, 2].map(along);
        let centre = self.dataset.train.iter().map(|view| view.camera.centre()).sum::<DVec3>();
        let centre = centre / self.dataset.train.len().max(1) as f64;
        let reason = format!(
            "no training view shows any of it: it has {x}, {y}, {z}, and the cameras are around {centre:.3}. Does it have other \
             coordinates than the dataset?"
        );
        Err(TrainError::Pretrained { key, path: self.given_path(key).into(), reason })
    }

    /// Says once of each file that takes the place of a stage what it leaves out, and which colours this run cannot hold.
    fn say_what_is_lost(&self) -> Result<(), TrainError> {
        let expected = self.config.model.colour;
        for key in [SURFELS_FROM, GAUSSIANS_FROM] {
            let Some(Opened { scene, remarks, .. }) = self.given(key)? else { continue };
            remarks.iter().for_each(|text| tracing::warn!("`{key}`: {text}"));
            let found = scene.info.colour_model;
            self.check_is_seen(key, scene)?;
            if found.without_opacity() != expected {
                tracing::warn!(
                    "`{key}`: its colours are {found}, those of this run {expected}: they begin as near to them as can be (model.colour)"
                );
            }
        }
        Ok(())
    }

    /// Gaussians in a file for a method that trains them alone, at most `most`: those of a blended scene as they are,
    /// those of others changed so that they show the same when they are sorted.
    ///
    /// # Errors
    /// [`TrainError::Pretrained`].
    pub fn given_gaussians(&self, most: usize) -> Result<Option<GaussianData>, TrainError> {
        let Some(scene) = self.pretrained(GAUSSIANS_FROM)? else { return Ok(None) };
        let wrong = |reason: String| {
            let path = PathBuf::from(&self.config.stages.gaussians_from);
            TrainError::Pretrained { key: GAUSSIANS_FROM, path, reason }
        };
        let gaussians = match scene.info.rendering {
            Rendering::Ellipsoids | Rendering::Students => scene.gaussians,
            _ => {
                let splats = flatten(&scene, MAX_DEGREE).map_err(|error| wrong(error.to_string()))?;
                let gaussians = splats.to_scene().gaussians;
                GaussianData { colour: recoloured(&gaussians.colour, self.config.model.colour), ..gaussians }
            }
        };
        let count = gaussians.len();
        if count > most {
            return Err(wrong(format!(
                "it has {count} Gaussians, and the budget has room for {most}: set refine.budget to {count}"
            )));
        }
        Ok(Some(gaussians))
    }
}

/// `colour` as near as `model` can have it: harmonics of another degree, lobes as harmonics, harmonics by their base
/// colour.
fn recoloured(colour: &ColourData, model: ColourModel) -> ColourData {
    match (colour.model.without_opacity(), model) {
        (found, model) if found == model => ColourData { model, ..colour.clone() },
        (_, ColourModel::SphericalHarmonics { degree }) => to_harmonics(colour, degree),
        (found, model) => {
            let count = colour.base.len() / 3;
            let mut new = GaussianData::neutral(model, count).colour;
            new.base = colour.base.clone();
            if let (ColourModel::SphericalBeta { .. }, ColourModel::SphericalBeta { .. }) = (found, model) {
                let (old, wide) = (found.detail_len(), model.detail_len());
                for row in 0..count {
                    let kept = old.min(wide);
                    new.detail[row * wide..][..kept].copy_from_slice(&colour.detail[row * old..][..kept]);
                }
            }
            new
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn colours_of_files_become_those_of_the_run() {
        let [beta, harmonics] = ["sb2", "sh1"].map(|name| name.parse::<ColourModel>().unwrap());
        let mut colour = GaussianData::neutral(beta, 2).colour;
        colour.base = vec![1.0, 2.0, 3.0, 4.0, 5.0, 6.0];
        colour.detail[..6].copy_from_slice(&[1.0, 0.5, 0.2, 0.7, 0.1, 0.3]);
        assert_eq!(recoloured(&colour, beta), colour);
        let fewer = recoloured(&colour, "sb1".parse().unwrap());
        assert_eq!((&fewer.detail[..6], &fewer.base), (&colour.detail[..6], &colour.base));
        let as_harmonics = recoloured(&colour, harmonics);
        assert_eq!((as_harmonics.model, as_harmonics.detail.len()), (harmonics, 18));
        // lobes add to the mean, and a bright one to one direction
        let [lit, plain] = [0, 3].map(|at| as_harmonics.base[at]);
        assert!(lit - 1.0 > 2.0 * (plain - 4.0) && plain >= 4.0, "{lit} {plain}");
        assert!(as_harmonics.detail[..9].iter().any(|k| k.abs() > 0.01));
        let more = recoloured(&as_harmonics, "sh3".parse().unwrap());
        assert_eq!((&more.detail[..9], &more.detail[9..45]), (&as_harmonics.detail[..9], &[0.0; 36][..]));
        assert_eq!(recoloured(&more, beta).base, more.base);
    }
}
