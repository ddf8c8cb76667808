//! Going on with a run that was stopped or killed. [`Run::resume`] reads the files back, [`Trainer::resume`] the state of the
//! steps, and [`stage::resume`](crate::stage::resume) that of the stage.

use std::sync::Arc;

use dpges_core::scene::{SceneData, SceneInfo};

use super::checkpoint::Checkpoint;
use super::folder::{Origin, RunFolder, remove, write_json};
use super::record::Record;
use super::{Run, RunError, TrainError, Trainer, shards, with_validation};
use crate::config::{Config, StagePlan};
use crate::dataset::Dataset;
use crate::device::memory::PeakMemory;
use crate::device::place::Place;

/// A run in a folder, before it goes on.
#[derive(Clone, Debug)]
pub struct SavedRun {
    folder: RunFolder,
    origin: Origin,
    checkpoint: Checkpoint,
    lengthened: bool,
    moved: bool,
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
        Ok(Self { folder, origin, checkpoint, lengthened: false, moved: false })
    }

    /// Makes the run end after `steps` instead. Only its last stage gets longer: it goes on as a stage of that length does
    /// after the steps that are done, with its learning rates and refinements. Returns what that means, in words.
    ///
    /// # Errors
    /// [`RunError::Train`] if not more steps than before and than are done are asked for.
    pub fn lengthen(&mut self, steps: usize) -> Result<String, RunError> {
        let state = &mut self.checkpoint.state;
        let (config, done) = (&mut state.config, state.completed_steps);
        let before = std::mem::replace(&mut config.train.steps, steps);
        if steps <= done || steps < before {
            return Err(RunError::Train(TrainError::Plan(format!(
                "train.steps = {steps}: {done} of {before} steps are done, and a run can only be made longer"
            ))));
        }
        for share in [&mut config.stages.surfels, &mut config.stages.gaussians, &mut config.stages.coarse] {
            *share = (*share * before as f64).round() / steps as f64;
        }
        state.validation.go_on();
        self.lengthened = true;
        Ok(format!(
            "it goes on from step {done} as a run of {steps} steps does there, not {before}: the last stage gets longer, learning \
             rates rise again to what they are after {:.0} % of it, and primitives come and go until its schedules are over",
            100.0 * self.share_of_last_stage()
        ))
    }

    /// The stages of the run in their order.
    pub fn plan(&self) -> Vec<StagePlan> {
        self.checkpoint.state.plan()
    }

    /// Share of the last stage that is done.
    fn share_of_last_stage(&self) -> f64 {
        let last = self.plan().last().copied();
        last.map_or(0.0, |last| self.completed_steps().saturating_sub(last.begin) as f64 / last.steps as f64)
    }

    /// Goes on with `dataset`, to which the one that the run was started with has moved.
    pub fn move_to(&mut self, dataset: String) {
        self.origin.dataset = dataset;
        self.moved = true;
    }

    /// The configuration that the run goes on with.
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
        let SavedRun { folder, origin, mut checkpoint, lengthened, moved } = saved;
        // `dpges scale` may have measured the scene that is about to be replaced
        let measured = SceneData::load(&folder.scene()).ok().and_then(|scene| scene.info.metres_per_unit);
        checkpoint.state.info.metres_per_unit = measured.or(checkpoint.state.info.metres_per_unit);
        let data = with_validation(data.into(), checkpoint.config());
        let place = place.into();
        if moved {
            check_moved(&checkpoint.state.info, &data)?;
        }
        let (completed, stage_is_over) = (checkpoint.completed_steps(), checkpoint.stage_is_over());
        let trainer = Trainer::resume(checkpoint, data, place)?;
        // only now, since what is refused changes nothing
        let (record, seconds_before) = if trainer.ranks().is_first() {
            if moved {
                write_json(&folder.origin(), &origin)?;
            }
            if lengthened {
                // the scene that they measured is no longer the result
                [folder.evaluation(), folder.validation()].iter().try_for_each(|file| remove(file))?;
                folder.write_config(trainer.config())?;
            }
            let (record, seconds) = Record::resume(folder.clone(), origin, completed, stage_is_over, peak)?;
            (Some(record), seconds)
        } else {
            (None, 0.0)
        };
        let saved = Some(completed);
        Ok(Self { folder: Some(folder), record, saved, seconds_before, ..Self::of(trainer, peak) })
    }
}

/// Largest difference of the extents of a dataset before and after it was moved, as a share.
const SAME_EXTENT: f64 = 0.01;

/// Whether `data` may be the dataset of a scene of `info`; the names of its views are compared by [`Trainer::resume`].
fn check_moved(info: &SceneInfo, data: &Dataset) -> Result<(), TrainError> {
    let [before, now] = [info.extent, data.extent];
    if (before - now).abs() <= SAME_EXTENT * before {
        return Ok(());
    }
    Err(TrainError::resume(format!(
        "its cameras had an extent of {before:.4}, and these have {now:.4}: it is another dataset"
    )))
}
