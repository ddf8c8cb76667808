//! Runs by single steps, on the built-in scene.

mod blocks;
mod depth;
mod exposure;
mod points;
mod poses;
mod ranks;
mod refinement;
mod resumption;
mod stages;

use std::path::Path;
use std::sync::Arc;

use crate::dataset::Dataset;
use crate::optimizer::scene_state::GaussianState;
use crate::run::Trainer;
use crate::run::checkpoint::Checkpoint;
use crate::run::fixtures::{STAGES, config, dataset, device, step_until};

fn trainer(set: &[&str]) -> Trainer {
    Trainer::new(config(set), dataset(), device()).unwrap()
}

fn finished(mut trainer: Trainer) -> Checkpoint {
    step_until(&mut trainer, Trainer::is_finished);
    trainer.checkpoint()
}

fn after(mut trainer: Trainer, steps: usize) -> Trainer {
    step_until(&mut trainer, |trainer| trainer.completed_steps() >= steps);
    trainer
}

fn saved_and_loaded(checkpoint: &Checkpoint) -> Checkpoint {
    Checkpoint::from_bytes(&checkpoint.to_bytes(), Path::new("memory")).unwrap()
}

/// A run on `data` that goes on from what the checkpoint of `first` says, and from nothing else.
fn resumed(first: &Trainer, data: Arc<Dataset>) -> Trainer {
    let checkpoint = first.checkpoint();
    let second = Trainer::resume(saved_and_loaded(&checkpoint), data, device()).unwrap();
    // what no later step would show, such as momenta of opaque Gaussians
    assert!(second.checkpoint() == checkpoint, "a checkpoint after {} is not read as it is", first.completed_steps());
    second
}

/// Stops a run on `data` after each of `stops` steps, goes on, and compares the end with that of a whole run, which it returns.
fn goes_on_alike(begin: impl Fn() -> Trainer, data: &Arc<Dataset>, stops: &[usize]) -> Checkpoint {
    let whole = finished(begin());
    for &stop in stops {
        let second = resumed(&after(begin(), stop), data.clone());
        assert!(finished(second) == whole, "stopped after {stop} steps of {:?}", whole.config().train);
    }
    whole
}

/// Takes the last step of the current stage, and says which it is.
fn end_stage(trainer: &mut Trainer) -> String {
    step_until(trainer, Trainer::stage_is_over);
    trainer.stage().kind.to_string()
}

fn gaussians(trainer: &mut Trainer) -> &mut GaussianState {
    trainer.stage.parameters().gaussians
}
