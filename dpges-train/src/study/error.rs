//! Why a study cannot go on.

use std::path::PathBuf;

use crate::run::{RunError, TrainError};

/// Why a study cannot begin, go on, or be reported.
#[derive(Debug, thiserror::Error)]
pub enum StudyError {
    /// The folder of a cell is not its own.
    #[error("{} holds another run: {reason}; choose another --out, or remove that folder", .path.display())]
    OtherRun { path: PathBuf, reason: String },
    /// The rows in a folder cannot be compared with those that are asked for.
    #[error("{} holds other measurements: {reason}; choose another --out, or remove that file", .path.display())]
    OtherRows { path: PathBuf, reason: String },
    /// The evaluation of a finished run is broken.
    #[error("{} cannot be read: {reason}; remove it to finish its run again", .path.display())]
    Evaluation { path: PathBuf, reason: String },
    /// The picture of a row is not there.
    #[error("{} cannot be read: {reason}; remove the JSON beside its folder to measure anew", .path.display())]
    Picture { path: PathBuf, reason: String },
    /// A variant has not what its stages need.
    #[error("{variant}: {source}; leave it out, or change the options that all have in common")]
    Untrainable { variant: String, source: Box<TrainError> },
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
    Json(#[from] serde_json::Error),
    #[error(transparent)]
    Io(#[from] std::io::Error),
}
