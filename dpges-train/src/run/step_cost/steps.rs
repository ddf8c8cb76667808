//! Training steps on a scene that is given.

use std::str::FromStr;
use std::sync::Arc;

use burn::tensor::Device;
use dpges_core::backend::device::is_gpu;
use dpges_core::camera::Camera;
use dpges_core::ranks::Alone;
use dpges_core::scene::tensors::tensor_to_rows;
use dpges_core::scene::{BlendOrder, Rendering, SceneData};
use glam::DVec3;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use super::lists::Lists;
use crate::config::{Config, Method, StageKind};
use crate::dataset::{Dataset, Format, Picture, PointCloud, View};
use crate::eval::rendered::Renderer;
use crate::run::{StepReport, TrainError};
use crate::stage::{self, Context, DevicePhotographs, PendingStep, Stage, begin_step};
use crate::views::exposure::ExposureState;
use crate::views::pose::PoseState;

/// Where in the stage the steps are, as a share: surfels are still judged, blended Gaussians still densified.
const PROGRESS: f64 = 0.4;
/// The photographs are as bright as this share of the scene's own pictures, so that there is something to learn.
const DARKER: f32 = 0.9;

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
    /// The one in which scenes that are drawn by `rendering` are trained.
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

/// Training steps of a scene from its cameras, in turns, at two fifths of a run of the default configuration, without
/// refinement in between. The scene learns its own pictures, a little darker.
pub struct Steps {
    scene: SceneData,
    context: Context,
    stage: Box<dyn Stage>,
    /// Index of the next view.
    next: usize,
    /// The step that a GPU works on.
    pending: Option<PendingStep>,
}

impl Steps {
    /// # Errors
    /// [`TrainError::Plan`] if there is nothing to train or no camera, [`TrainError::Core`] if the scene cannot be
    /// rendered.
    pub fn new(scene: &SceneData, cameras: &[Camera], stage: StepStage, device: &Device) -> Result<Self, TrainError> {
        let (surfels, gaussians) = (scene.surfels.len(), scene.gaussians.len());
        if gaussians == 0 && (surfels == 0 || stage == StepStage::Blended) {
            return Err(TrainError::Plan(format!(
                "there is nothing to train: {surfels} surfels, {gaussians} Gaussians"
            )));
        }
        if cameras.is_empty() {
            return Err(TrainError::Plan("there is no camera to see the scene from".into()));
        }
        let config = config(scene, stage);
        let plan = *config.plan().last().expect("a run has stages");
        let dataset = Arc::new(dataset(scene, cameras, device)?);
        let photographs = DevicePhotographs::new(&config, device);
        let budget = stage::budget(&config, &dataset);
        let context = Context {
            dataset,
            config,
            device: device.clone(),
            ranks: Arc::new(Alone),
            rng: ChaCha8Rng::seed_from_u64(0),
            remaining_views: Vec::new(),
            completed_steps: plan.begin + (PROGRESS * plan.steps as f64) as usize,
            exposure: ExposureState::default(),
            poses: PoseState::default(),
            depth: None,
            photographs,
            surroundings: None,
            budget,
        };
        let stage = stage::of_scene(plan, scene, &context);
        Ok(Self { scene: scene.clone(), context, stage, next: 0, pending: None })
    }

    /// Hands a step over to the device. On a GPU it waits for the one before, on a CPU for this one.
    ///
    /// # Errors
    /// [`TrainError::Step`] or [`TrainError::Loss`] if the loss or a gradient was not finite, [`TrainError::Device`] if
    /// the device failed.
    pub fn step(&mut self) -> Result<(), TrainError> {
        let view = self.next % self.context.dataset.train.len();
        self.next += 1;
        let report = StepReport::begin(self.context.completed_steps + 1, self.kind(), view, Vec::new());
        let begun = begin_step(&mut *self.stage, &mut self.context, report)?;
        self.settle()?;
        self.pending = Some(begun.learn(&mut *self.stage, &mut self.context)?);
        if is_gpu(&self.context.device) { Ok(()) } else { self.settle() }
    }

    /// Waits for the step that the device works on.
    ///
    /// # Errors
    /// The errors of [`step`](Self::step).
    pub fn settle(&mut self) -> Result<(), TrainError> {
        self.pending.take().map_or(Ok(()), |step| step.settle().map(drop))
    }

    /// Takes one step and waits for it.
    ///
    /// # Errors
    /// The errors of [`step`](Self::step).
    pub fn step_and_settle(&mut self) -> Result<(), TrainError> {
        self.settle()?;
        self.step()?;
        self.settle()
    }

    /// The tile lists of the first view, of the scene as it was given.
    ///
    /// # Errors
    /// [`TrainError::Core`] if it cannot be rendered.
    pub fn lists(&self) -> Result<Lists, TrainError> {
        let camera = &self.context.dataset.train[0].camera;
        Ok(Lists::new(&self.scene, self.kind(), camera, &self.context.device)?)
    }

    pub fn device(&self) -> &Device {
        &self.context.device
    }

    pub fn views(&self) -> usize {
        self.context.dataset.train.len()
    }

    /// Width and height of the first view, px.
    pub fn size(&self) -> [usize; 2] {
        let camera = &self.context.dataset.train[0].camera;
        [camera.width, camera.height]
    }

    /// Surfels and Gaussians that learn.
    pub fn primitives(&mut self) -> (usize, usize) {
        let parameters = self.stage.parameters();
        (parameters.surfels.len(), parameters.gaussians.len())
    }

    /// The kind of stage that the steps train.
    pub fn kind(&self) -> StageKind {
        self.stage.plan().kind
    }
}

/// The default configuration with the model of `scene`, and one stage.
fn config(scene: &SceneData, stage: StepStage) -> Config {
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
    config.model.backstop = info.backstop;
    config.model.margin_lookup = info.margin_lookup;
    config
}

/// Views of `scene` from `cameras` as photographs.
fn dataset(scene: &SceneData, cameras: &[Camera], device: &Device) -> dpges_core::Result<Dataset> {
    let renderer = Renderer::new(scene, device);
    let view = |(number, camera): (usize, &Camera)| -> dpges_core::Result<View> {
        let image = tensor_to_rows(renderer.render(camera)?.image());
        let planes: Vec<f32> = image.into_iter().map(|value| DARKER * value.clamp(0.0, 1.0)).collect();
        let photograph = Picture::from_planes(&planes, camera.width, camera.height).into();
        Ok(View { name: format!("view_{number:03}"), camera: *camera, photograph, depth: None })
    };
    Ok(Dataset {
        train: cameras.iter().enumerate().map(view).collect::<dpges_core::Result<_>>()?,
        test: Vec::new(),
        validation: Vec::new(),
        points: PointCloud::default(),
        offset: DVec3::from_array(scene.info.offset),
        extent: scene.info.extent,
        background: scene.info.background,
        format: Format::Builtin,
        near: scene.info.near,
        spare_memory: usize::MAX,
    })
}
