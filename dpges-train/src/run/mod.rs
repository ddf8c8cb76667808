//! A run from configuration and data to a scene.
//!
//! ```no_run
//! use dpges_train::config::Config;
//! use dpges_train::dataset;
//! use dpges_train::device::DeviceName;
//! use dpges_train::run::{Run, StepReport};
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let config = Config::resolve(Some("cpu"), None, &["train.steps=1000".to_owned()])?;
//! let data = dataset::load("data/garden".as_ref(), &config.data.load_options())?;
//! let device = "cpu".parse::<DeviceName>()?.open()?;
//!
//! let mut run = Run::new(config, data, device)?;
//! let outcome = run.train(&mut |report: &StepReport| println!("{:5}  loss {:.4}", report.step, report.loss))?;
//!
//! outcome.scene.save("garden.safetensors".as_ref())?;
//! if let Some(evaluation) = outcome.evaluation {
//!     println!("held out: {:.2} dB", evaluation.psnr);
//! }
//! # Ok(())
//! # }
//! ```
//!
//! [`Run::new`] keeps everything in memory. [`Run::write_to`] makes it write scenes, checkpoints, metrics and pictures
//! to a [folder], from which [`Run::resume`] goes on after it was stopped or killed, to identical bytes. An [`Observer`]
//! is told of everything that happens, and can stop the run. A [`Trainer`] takes single steps, without evaluations and
//! files.

pub mod checkpoint;
pub mod child;
pub mod clean;
pub mod consolidate;
pub mod description;
mod error;
#[cfg(test)]
pub mod fixtures;
pub mod folder;
pub mod hash;
pub mod hold;
pub mod interrupts;
pub mod jobs;
#[cfg(test)]
mod masked_tests;
pub mod metrics_log;
mod observer;
pub mod own_pictures;
#[cfg(test)]
mod peak_tests;
#[cfg(test)]
mod ranks_tests;
pub mod recommendation;
mod record;
pub mod refit;
mod resume;
pub mod scale;
pub mod scene;
mod shards;
pub mod shell;
pub mod shots;
pub mod sink;
pub mod step_cost;
#[cfg(test)]
mod streamed_tests;
pub mod targets;
#[cfg(test)]
mod tests;
mod trainer;
mod training_loop;
mod validation;
pub mod view_choice;

use std::sync::Arc;
use std::time::Instant;

use dpges_core::scene::SceneData;

use crate::config::Config;
use crate::dataset::Dataset;
use crate::device::memory::PeakMemory;
use crate::device::place::Place;
use crate::eval::Evaluation;
pub use crate::stage::{StepReport, TrainError, budget};
pub use error::RunError;
use folder::{Origin, RunFolder};
pub use observer::Observer;
use record::Record;
pub use resume::SavedRun;
pub use trainer::Trainer;
pub use validation::{Validation, Verdict};

/// A run from its first step, or the one it was stopped after, to its last.
pub struct Run {
    trainer: Trainer,
    /// Peak memory since the run began or went on.
    peak: PeakMemory,
    /// Where it writes to; `None` if it is kept in memory.
    folder: Option<RunFolder>,
    /// The files that the first rank writes; `None` on others, and if the run is kept in memory.
    record: Option<Record>,
    /// Completed steps of the checkpoint in the folder.
    saved: Option<usize>,
    /// The best scene by the validation views, unless it is in the folder.
    best: Option<SceneData>,
    /// The scene that the last stage began with, unless it is in the folder or there was no stage before.
    before_last_stage: Option<SceneData>,
    /// Time that the run had taken when [`train`](Run::train) was called last.
    seconds_before: f64,
    started: Instant,
}

/// The result of a finished run.
#[derive(Clone, Debug, PartialEq)]
pub struct Outcome {
    /// The scene after the last step; with `train.stop = "validation"` the best by the validation views. The scene of the
    /// stage before the last if validation views are better with that.
    pub scene: SceneData,
    /// How well it shows the held-out views; `None` if there are none.
    pub evaluation: Option<Evaluation>,
    /// Wall clock of training, evaluations on the way included, before and after every resumption.
    pub seconds: f64,
}

impl Run {
    /// A run before its first step, in memory, on a device alone or on one of several ranks. Where the configuration decides by
    /// validation views and `data` has none, every [`Config::validation_every`]th training view becomes one.
    ///
    /// # Errors
    /// [`RunError::Train`] if the dataset, or a file that the configuration names, is not what the run begins with.
    pub fn new(config: Config, data: impl Into<Arc<Dataset>>, place: impl Into<Place>) -> Result<Self, RunError> {
        let peak = PeakMemory::start();
        let data = with_validation(data.into(), &config);
        Ok(Self::of(Trainer::new(config, data, place)?, peak))
    }

    fn of(trainer: Trainer, peak: PeakMemory) -> Self {
        Self {
            trainer,
            peak,
            folder: None,
            record: None,
            saved: None,
            best: None,
            before_last_stage: None,
            seconds_before: 0.0,
            started: Instant::now(),
        }
    }

    /// Makes the run write to `folder` from now on. The first of several ranks writes all files, the others their parts
    /// of checkpoints.
    ///
    /// # Errors
    /// [`RunError::Folder`] if the folder holds another run or cannot be written.
    pub fn write_to(self, folder: RunFolder, origin: Origin) -> Result<Self, RunError> {
        folder.check_unused()?;
        self.overwrite(folder, origin)
    }

    /// Like [`write_to`](Self::write_to), but removes the files of another run in `folder`, and nothing else.
    pub fn overwrite(self, folder: RunFolder, origin: Origin) -> Result<Self, RunError> {
        if !self.trainer.ranks().is_first() {
            return Ok(Self { folder: Some(folder), saved: None, best: None, ..self });
        }
        let record = Record::start(folder.clone(), origin, self.trainer.config(), self.peak)?;
        if let Some(best) = &self.best {
            best.save(&record.folder.best())?;
        }
        Ok(Self { folder: Some(folder), record: Some(record), saved: None, best: None, ..self })
    }

    /// The object that takes the steps of the run: it knows the scene as it stands, the configuration and the state.
    pub fn trainer(&self) -> &Trainer {
        &self.trainer
    }

    /// Where the run writes to; `None` if it is kept in memory.
    pub fn folder(&self) -> Option<&RunFolder> {
        self.folder.as_ref()
    }

    /// Completed steps of the checkpoint in the folder; `None` if there is none.
    pub fn saved_step(&self) -> Option<usize> {
        self.saved
    }
}

fn with_validation(mut data: Arc<Dataset>, config: &Config) -> Arc<Dataset> {
    let every = config.validation_every();
    if every > 0 && data.validation.is_empty() {
        Arc::make_mut(&mut data).keep_for_validation(every);
    }
    data
}
