//! Runs by single steps, on the built-in scene.

mod blocks;
mod depth;
mod exposure;
mod poses;
mod ranks;
mod refinement;
mod resumption;
mod stages;

use std::path::Path;

use crate::optimizer::scene_state::GaussianState;
use crate::run::Trainer;
use crate::run::checkpoint::Checkpoint;
use crate::run::fixtures::{config, dataset, device};

fn trainer(set: &[&str]) -> Trainer {
    Trainer::new(config(set), dataset(), device()).unwrap()
}

/// All stages and everything that changes something in them.
const STAGES: [&str; 13] = [
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

fn finished(mut trainer: Trainer) -> Checkpoint {
    while !trainer.is_finished() {
        trainer.step().unwrap();
    }
    trainer.checkpoint()
}

fn saved_and_loaded(checkpoint: &Checkpoint, folder: &Path) -> Checkpoint {
    let path = folder.join("checkpoint.safetensors");
    checkpoint.save(&path).unwrap();
    Checkpoint::load(&path).unwrap()
}

fn gaussians(trainer: &mut Trainer) -> &mut GaussianState {
    trainer.stage.parameters().gaussians
}
