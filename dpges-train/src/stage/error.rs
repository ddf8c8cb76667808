use std::path::PathBuf;

use crate::init::InitError;

/// Why a run cannot begin, go on or be resumed.
#[derive(Debug, thiserror::Error)]
pub enum TrainError {
    #[error("initialisation: {0}")]
    Init(#[from] InitError),
    #[error("`{key}`: {path} cannot be used: {reason}")]
    Pretrained { key: &'static str, path: PathBuf, reason: String },
    /// The stages, or what decides on them, lack something.
    #[error("{0}")]
    Plan(String),
    /// A render or a gradient was not finite. No parameter has learnt from it.
    #[error("step {step}, view `{view}`: {source}; the step was not taken")]
    Step { step: usize, view: String, source: dpges_core::Error },
    /// The loss was not finite. No parameter has learnt from it.
    #[error("step {step}, view `{view}`: the loss is {loss}; the step was not taken")]
    Loss { step: usize, view: String, loss: f64 },
    /// The device failed at or before this step: its contents are worth nothing.
    #[error("step {step}: the device failed: {reason}")]
    Device { step: usize, reason: String },
    /// A step failed on one rank of several: it is not known how far the others are.
    #[error("rank {rank}: {source}")]
    OnRank { rank: usize, source: Box<Self> },
    /// Ranks differ in what all of them should have alike.
    #[error(
        "step {step}: rank {rank} does not have the surfels that the others have, to the bit: train on devices of one kind \
         with one driver, or with one process for each kind"
    )]
    Diverged { step: usize, rank: usize },
    #[error(transparent)]
    Core(#[from] dpges_core::Error),
    #[error("the checkpoint does not fit: {reason}")]
    Resume { reason: String },
}

impl TrainError {
    pub fn resume(reason: String) -> Self {
        Self::Resume { reason }
    }
}
