use std::io::ErrorKind;
use std::path::PathBuf;

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
    /// There is no room for a file. `rescued` holds the state after `step` instead, unless there was none for that either, or the
    /// checkpoint of the folder has it.
    #[error("the disk is full: {source}")]
    DiskFull { source: Box<Self>, step: usize, rescued: Option<PathBuf> },
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

impl RunError {
    /// Whether a file could not be written for want of room.
    pub fn is_full(&self) -> bool {
        let chain = std::iter::successors(Some(self as &dyn std::error::Error), |error| error.source());
        let kinds = chain.filter_map(|error| error.downcast_ref::<std::io::Error>()).map(std::io::Error::kind);
        kinds.into_iter().any(|kind| matches!(kind, ErrorKind::StorageFull | ErrorKind::QuotaExceeded))
    }
}
