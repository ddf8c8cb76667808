//! Going on with a run that was stopped or killed. [`Run::resume`] reads the files back, [`Trainer::resume`] the state of the
//! steps, and [`stage::resume`](crate::stage::resume) that of the stage.

use std::sync::Arc;

use super::checkpoint::Checkpoint;
use super::folder::{Origin, RunFolder};
use super::record::Record;
use super::{Run, RunError, Trainer, shards, with_validation};
use crate::config::Config;
use crate::dataset::Dataset;
use crate::device::memory::PeakMemory;
use crate::device::place::Place;

/// A run in a folder, before it goes on.
#[derive(Clone, Debug)]
pub struct SavedRun {
    folder: RunFolder,
    origin: Origin,
    checkpoint: Checkpoint,
}

impl SavedRun {
    /// Reads the checkpoint in `folder`, and what the run was started with.
    ///
    /// # Errors
    /// [`RunError::Folder`] if the folder holds no run that can go on, [`RunError::Checkpoint`] if the checkpoint cannot
    /// be read.
    pub fn open(folder: RunFolder) -> Result<Self, RunError> {
        folder.check_resumable()?;
        let checkpoint = shards::load(&folder)?;
        let origin = folder.read_origin()?;
        Ok(Self { folder, origin, checkpoint })
    }

    /// The configuration that the run was started with and goes on with.
    pub fn config(&self) -> &Config {
        self.checkpoint.config()
    }

    /// The dataset and the device that the run was started with.
    pub fn origin(&self) -> &Origin {
        &self.origin
    }

    pub fn completed_steps(&self) -> usize {
        self.checkpoint.completed_steps()
    }
}

impl Run {
    /// Goes on where `saved` was last saved, with the dataset that it was started with.
    ///
    /// # Errors
    /// [`RunError::Train`] if the dataset is another one or the checkpoint contradicts itself, [`RunError::Core`] if the
    /// metrics cannot be read.
    pub fn resume(saved: SavedRun, data: impl Into<Arc<Dataset>>, place: impl Into<Place>) -> Result<Self, RunError> {
        let peak = PeakMemory::start();
        let SavedRun { folder, origin, checkpoint } = saved;
        let data = with_validation(data.into(), checkpoint.config());
        let place = place.into();
        let (record, seconds_before) = if place.ranks.is_first() {
            let (record, seconds) = Record::resume(folder.clone(), origin, &checkpoint, peak)?;
            (Some(record), seconds)
        } else {
            (None, 0.0)
        };
        let saved = Some(checkpoint.completed_steps());
        let trainer = Trainer::resume(checkpoint, data, place)?;
        Ok(Self { folder: Some(folder), record, saved, seconds_before, ..Self::of(trainer, peak) })
    }
}
