//! Why a run ends before its last step.

use super::checkpoint::CheckpointError;
use super::folder::RunFolderError;
use crate::stage::TrainError;

/// Why a run cannot begin, go on or end.
#[derive(Debug, thiserror::Error)]
pub enum RunError {
    /// The observer has asked to stop. [`Run::train`](super::Run::train) goes on if it is called again, as does a run in
    /// a folder if it is [resumed](super::Run::resume).
    #[error("stopped after step {step} of {steps}")]
    Stopped { step: usize, steps: usize },
    /// The run cannot be trained, or a step failed.
    #[error(transparent)]
    Train(#[from] TrainError),
    /// The folder does not hold what it should.
    #[error(transparent)]
    Folder(#[from] RunFolderError),
    /// The checkpoint cannot be written or read.
    #[error(transparent)]
    Checkpoint(#[from] CheckpointError),
    /// Another file cannot be written or read, or a view cannot be rendered.
    #[error(transparent)]
    Core(#[from] dpges_core::Error),
}
