//! Stages of a scene that is given, which learns from pictures of a scene.

use std::str::FromStr;
use std::sync::Arc;

use burn::tensor::Device;
use dpges_core::scene::{BlendOrder, Rendering, SceneData, SceneInfo};
use glam::DVec3;

use crate::config::{Config, Method, StagePlan};
use crate::dataset::{Dataset, Format, Notices, PointCloud, View};
use crate::stage::Context;

/// Which step is taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StepStage {
    /// Surfels and Gaussians together (DP-GES).
    Joint,
    /// The Gaussians alone, blended in the order of their depths: as in 2DGS if the scene is one of discs, summed if it is one
    /// of weighted sums, else as in 3DGS-MCMC.
    Blended,
}

impl StepStage {
    /// The stage in which scenes that are drawn by `rendering` are trained.
    pub fn of(rendering: Rendering) -> Self {
        if rendering == Rendering::Peeled { Self::Joint } else { Self::Blended }
    }
}

impl FromStr for StepStage {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "joint" => Ok(Self::Joint),
            "blended" => Ok(Self::Blended),
            _ => Err(format!("there is no stage `{text}`: joint (surfels and Gaussians) or blended (Gaussians alone)")),
        }
    }
}

/// The default configuration with the model of `scene`, and one stage.
pub fn config(scene: &SceneData, stage: StepStage) -> Config {
    let info = &scene.info;
    let mut config = Config::default();
    config.train.method = match (stage, info.rendering) {
        (StepStage::Joint, _) => Method::Dpges,
        (StepStage::Blended, Rendering::Discs) => Method::Discs,
        (StepStage::Blended, _) if info.blend_order == BlendOrder::Rays => Method::StopThePop,
        (StepStage::Blended, _) if info.blend_order.transparency().is_some() => Method::Htgs,
        (StepStage::Blended, Rendering::Students) => Method::Sss,
        (StepStage::Blended, Rendering::Summed) => Method::SortFree,
        (StepStage::Blended, Rendering::Peeled | Rendering::Ellipsoids) => Method::Mcmc,
    };
    config.density.transparency = info.blend_order.transparency().unwrap_or_default();
    (config.stages.surfels, config.stages.gaussians) = (0.0, 0.0);
    config.model.colour = info.colour_model.without_opacity();
    config.model.modulation = info.modulation;
    config.model.layers = info.layer_count;
    config.model.footprint = info.footprint;
    config.model.peeling = info.peeling;
    config
}

/// The `train` views, in the coordinates of a scene with `info`.
pub fn dataset(info: &SceneInfo, train: Vec<View>) -> Dataset {
    Dataset {
        reprojection_px: None,
        train,
        test: Vec::new(),
        validation: Vec::new(),
        points: PointCloud::default(),
        offset: DVec3::from_array(info.offset),
        extent: info.extent,
        background: info.background,
        format: Format::Builtin,
        near: info.near,
        notices: Notices::default(),
        spare_memory: usize::MAX,
    }
}

/// A run of `config` on `dataset` that comes to its last stage, `done` (0 to 1) of which is over.
pub fn last_stage(config: Config, dataset: Dataset, done: f64, device: &Device) -> (StagePlan, Context) {
    let plan = *config.plan(0).last().expect("a run has stages");
    let mut context = Context::new(config, Arc::new(dataset), device.clone().into());
    context.completed_steps = plan.begin + (done * plan.steps as f64) as usize;
    (plan, context)
}
