//! Small runs for tests.

use std::sync::Arc;

use burn::tensor::Device;
use dpges_core::camera::{Camera, CameraFromWorld};

use super::Trainer;
use super::checkpoint::Checkpoint;
use crate::config::Config;
use crate::dataset::{BuiltinOptions, Dataset, builtin};
use crate::device::DeviceName;

pub fn dataset() -> Arc<Dataset> {
    dataset_of(3)
}

pub fn dataset_of(train_views: usize) -> Arc<Dataset> {
    Arc::new(builtin(&options(24, [train_views, 1], 200)))
}

/// The built-in scene in so many training and test views, square pictures of `size` px.
pub fn options(size: usize, [train_views, test_views]: [usize; 2], points: usize) -> BuiltinOptions {
    BuiltinOptions { width: size, height: size, train_views, test_views, points, ..Default::default() }
}

/// Taken through a fisheye lens.
pub fn fisheye_dataset() -> Arc<Dataset> {
    Arc::new(builtin(&BuiltinOptions { fisheye: true, ..options(32, [6, 2], 400) }))
}

/// A pinhole camera whose axis meets the middle of the picture; `focal` in px.
pub fn camera(camera_from_world: CameraFromWorld, focal: f64, size: [usize; 2]) -> Camera {
    Camera::pinhole(camera_from_world, focal, size, 0.1)
}

/// Keys that make of the defaults a run of the joint stage alone, or, with a share, after a stage of DBS.
const ALONE: [&str; 3] = ["stages.gaussians=0", "stages.gaussians_by=dbs", "stages.gaussian_budget=0.6"];

/// All stages and everything that changes something in them.
pub const STAGES: [&str; 13] = [
    "train.steps=60",
    "train.lambda_opacity=0.01",
    "train.lambda_gaussian_scale=0.01",
    "model.environment=sh1",
    "model.sampling_limit=0.3",
    "refine.budget=700",
    "stages.surfels=0.3",
    "stages.gaussians=0.3",
    "stages.surfel_opacity=0.12",
    "train.lambda_disc_depth=0.1",
    "train.lambda_disc_normal=0.05",
    "train.lambda_disc_depth_normal=0.05",
    "density.gradient_threshold=1e-7",
];

/// The defaults, without a stage of Gaussians, with `set` on top.
pub fn config(set: &[&str]) -> Config {
    let set: Vec<String> = ALONE.iter().chain(set).map(|&text| text.to_owned()).collect();
    Config::resolve(None, None, &set).unwrap()
}

/// A run at its end.
pub fn trained(set: &[&str], data: Arc<Dataset>) -> Trainer {
    let mut trainer = Trainer::new(config(set), data, device()).unwrap();
    step_until(&mut trainer, Trainer::is_finished);
    trainer
}

pub fn step_until(trainer: &mut Trainer, done: impl Fn(&Trainer) -> bool) {
    while !done(trainer) {
        trainer.step().unwrap();
    }
}

pub fn finished(set: &[&str], data: Dataset) -> Checkpoint {
    trained(set, Arc::new(data)).checkpoint()
}

pub fn device() -> Device {
    "cpu".parse::<DeviceName>().unwrap().open().unwrap()
}
