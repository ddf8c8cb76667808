//! Why a capture in blocks cannot be planned or trained.

use std::path::PathBuf;

use dpges_train::run::RunError;
use dpges_train::run::jobs::OtherRun;

/// Why a step of a capture in blocks cannot be done.
#[derive(Debug, thiserror::Error)]
pub enum BlocksError {
    /// There is nothing to split.
    #[error(
        "{dataset} has no points to split into blocks: blocks are for captures with points, such as those of COLMAP"
    )]
    NoPoints { dataset: String },
    /// Points are at fewer places than there are to be blocks.
    #[error("the points of {dataset} are at {found} places that can be told apart: ask for at most {found} blocks")]
    FewPlaces { dataset: String, found: usize },
    /// Cameras would move in every block by themselves.
    #[error(
        "train.poses = \"on\" moves cameras in each block by itself: refine them in a run of the whole capture, and plan blocks \
         with train.poses = \"off\""
    )]
    Poses,
    /// The method has no surroundings.
    #[error("blocks are scenes of surfels and Gaussians: train.method is not \"dpges\"")]
    Method,
    /// The folder holds another plan.
    #[error("{} holds another plan: {reason}; choose another --out, or remove that folder", .path.display())]
    OtherPlan { path: PathBuf, reason: String },
    /// There is no plan yet.
    #[error("{} holds no plan: `dpges blocks plan DATASET --out {}` makes one", .path.display(), .path.display())]
    NoPlan { path: PathBuf },
    #[error("there is no block {block}: the plan has {count}, from 0")]
    NoBlock { block: usize, count: usize },
    /// A step before this one is not done.
    #[error("{missing} is not trained yet: `{command}` does it")]
    Missing { missing: String, command: String },
    /// The folder of a step is not its own.
    #[error(transparent)]
    OtherRun(#[from] OtherRun),
    /// A plot cannot be drawn, which is a fault of the program.
    #[error("the picture of the plan cannot be drawn: {0}")]
    Picture(String),
    #[error(transparent)]
    Run(#[from] RunError),
    #[error(transparent)]
    Core(#[from] dpges_core::Error),
}

impl BlocksError {
    /// Whether a step or a plan was asked for wrongly.
    pub fn is_usage(&self) -> bool {
        matches!(self, Self::NoBlock { .. } | Self::Poses | Self::Method | Self::FewPlaces { .. })
    }
}
