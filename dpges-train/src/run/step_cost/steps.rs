//! Training steps on a scene that is given.

use burn::tensor::Device;
use dpges_core::backend::device::is_gpu;
use dpges_core::camera::Camera;
use dpges_core::scene::SceneData;
use dpges_core::scene::tensors::tensor_to_rows;

use crate::config::StageKind;
use crate::dataset::{Picture, View};
use crate::eval::rendered::TrainingRenderer;
use crate::run::own_pictures::{StepStage, config, dataset, last_stage};
use crate::run::{StepReport, TrainError};
use crate::stage::{self, Context, PendingStep, Stage, StepViews, begin_step};

/// Where in the stage the steps are, as a share: surfels are still judged, blended Gaussians still densified.
const PROGRESS: f64 = 0.4;
/// The photographs are as bright as this share of the scene's own pictures, so that there is something to learn.
const DARKER: f32 = 0.9;

/// Training steps of a scene from its cameras, in turns, at two fifths of a run of the default configuration, without
/// refinement in between. The scene learns its own pictures, a little darker.
pub struct Steps {
    context: Context,
    stage: Box<dyn Stage>,
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
        let train = pictures(scene, cameras, device)?;
        let (plan, context) = last_stage(config(scene, stage), dataset(&scene.info, train), PROGRESS, device);
        let stage = stage::of_scene(plan, scene, &context)?;
        Ok(Self { context, stage, next: 0, pending: None })
    }

    /// Hands a step over to the device. On a GPU it waits for the one before, on a CPU for this one.
    ///
    /// # Errors
    /// [`TrainError::Step`] or [`TrainError::Loss`] if the loss or a gradient was not finite, [`TrainError::Device`] if
    /// the device failed.
    pub fn step(&mut self) -> Result<(), TrainError> {
        let view = self.next % self.context.dataset.train.len();
        self.next += 1;
        let report = StepReport::begin(self.context.completed_steps + 1, self.stage.plan(), view, Vec::new());
        let begun = begin_step(&mut *self.stage, &mut self.context, report, StepViews::one(view))?;
        self.settle()?;
        self.pending = Some(begun.learn(&mut *self.stage, &mut self.context)?);
        if is_gpu(&self.context.device) { Ok(()) } else { self.settle() }
    }

    /// # Errors
    /// The errors of [`step`](Self::step).
    pub fn settle(&mut self) -> Result<(), TrainError> {
        self.pending.take().map_or(Ok(()), |step| step.settle().map(drop))
    }

    /// # Errors
    /// The errors of [`step`](Self::step).
    pub fn step_and_settle(&mut self) -> Result<(), TrainError> {
        self.settle()?;
        self.step()?;
        self.settle()
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

/// Views of `scene` from `cameras` as photographs.
fn pictures(scene: &SceneData, cameras: &[Camera], device: &Device) -> dpges_core::Result<Vec<View>> {
    let renderer = TrainingRenderer::new(scene, device);
    let view = |(number, camera): (usize, &Camera)| -> dpges_core::Result<View> {
        let image = tensor_to_rows(renderer.render(camera)?.image());
        let planes: Vec<f32> = image.into_iter().map(|value| DARKER * value.clamp(0.0, 1.0)).collect();
        let photograph = Picture::from_planes(&planes, camera.width, camera.height).into();
        Ok(View { name: format!("view_{number:03}"), camera: *camera, photograph, depth: None, face: None })
    };
    cameras.iter().enumerate().map(view).collect()
}
