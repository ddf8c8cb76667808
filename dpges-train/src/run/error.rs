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
    #[error(transparent)]
    Train(#[from] TrainError),
    #[error(transparent)]
    Folder(#[from] RunFolderError),
    #[error(transparent)]
    Checkpoint(#[from] CheckpointError),
    /// Another file cannot be written or read, or a view cannot be rendered.
    #[error(transparent)]
    Core(#[from] dpges_core::Error),
}
