//! Why a study cannot go on.

use std::path::PathBuf;

use dpges_train::config::ConfigError;
use dpges_train::metrics::lpips::choice::ChoiceError;
use dpges_train::run::jobs::OtherRun;
use dpges_train::run::{RunError, TrainError};

use super::benchmark::layout::LayoutError;

/// Why a study cannot begin, go on, or be reported.
#[derive(Debug, thiserror::Error)]
pub enum StudyError {
    #[error(transparent)]
    OtherRun(#[from] OtherRun),
    #[error("{} holds other measurements: {reason}; choose another --out, or remove that file", .path.display())]
    OtherRows { path: PathBuf, reason: String },
    #[error("{} cannot be read: {reason}; remove it to finish its run again", .path.display())]
    Evaluation { path: PathBuf, reason: String },
    #[error("{} cannot be read: {reason}; remove the JSON beside its folder to measure anew", .path.display())]
    Picture { path: PathBuf, reason: String },
    #[error("{variant}: {source}; leave it out, or change the options that all have in common")]
    Untrainable { variant: String, source: Box<TrainError> },
    #[error("there is no cell `{name}`; cells are called DATASET/SCENE/METHOD/seed_N")]
    NoCell { name: String },
    /// Cells of a benchmark ended with an error; the others are in its tables.
    #[error("{failed} of {all} cells failed; the same command tries them again:\n{reasons}")]
    Cells { failed: usize, all: usize, reasons: String },
    #[error("interrupted: the same command goes on with the cells that are not finished")]
    Interrupted,
    #[error(transparent)]
    Layout(#[from] LayoutError),
    #[error(transparent)]
    Config(#[from] ConfigError),
    #[error(transparent)]
    Lpips(#[from] ChoiceError),
    /// This is a fault of the program.
    #[error("a plot cannot be drawn: {0}")]
    Plot(String),
    #[error(transparent)]
    Run(#[from] RunError),
    #[error(transparent)]
    Core(#[from] dpges_core::Error),
    #[error(transparent)]
    Render(#[from] dpges_render::RenderError),
    #[error(transparent)]
    Image(#[from] image::ImageError),
    #[error(transparent)]
    Io(#[from] std::io::Error),
}
