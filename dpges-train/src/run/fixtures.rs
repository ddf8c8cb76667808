//! Small runs for tests.

use std::sync::Arc;

use burn::tensor::Device;

use super::Trainer;
use super::checkpoint::Checkpoint;
use crate::config::Config;
use crate::dataset::{BuiltinOptions, Dataset, builtin};
use crate::device::DeviceName;

pub fn dataset() -> Arc<Dataset> {
    dataset_of(3)
}

pub fn dataset_of(train_views: usize) -> Arc<Dataset> {
    let options =
        BuiltinOptions { width: 24, height: 24, train_views, test_views: 1, points: 200, ..Default::default() };
    Arc::new(builtin(&options))
}

/// Taken through a fisheye lens.
pub fn fisheye_dataset() -> Arc<Dataset> {
    let (width, height, train_views, test_views, points) = (32, 32, 6, 2, 400);
    let fisheye = true;
    let options = BuiltinOptions { width, height, train_views, test_views, points, fisheye, ..Default::default() };
    Arc::new(builtin(&options))
}

/// Keys that make of the defaults a run of the joint stage alone, or, with a share, after a stage of DBS.
const ALONE: [&str; 3] = ["stages.gaussians=0", "stages.gaussians_by=dbs", "stages.gaussian_budget=0.6"];

/// The defaults, without a stage of Gaussians, with `set` on top.
pub fn config(set: &[&str]) -> Config {
    let set: Vec<String> = ALONE.iter().chain(set).map(|&text| text.to_owned()).collect();
    Config::resolve(None, None, &set).unwrap()
}

/// The state of a run at its end.
pub fn finished(set: &[&str], data: Dataset) -> Checkpoint {
    let mut trainer = Trainer::new(config(set), Arc::new(data), device()).unwrap();
    while !trainer.is_finished() {
        trainer.step().unwrap();
    }
    trainer.checkpoint()
}

pub fn device() -> Device {
    "cpu".parse::<DeviceName>().unwrap().open().unwrap()
}
