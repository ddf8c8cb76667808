//! Why there is no dataset. Every message says what to do.

use std::path::PathBuf;

use super::step::Step;
use crate::DatasetError;

/// Why photographs have become no dataset.
#[derive(Debug, thiserror::Error)]
pub enum SfmError {
    #[error("{program} is not installed, {purpose}; {remedy}")]
    MissingProgram { program: &'static str, purpose: &'static str, remedy: String },
    #[error("{path} has no name to call a dataset after; name the folder of the dataset")]
    NoName { path: PathBuf },
    #[error(
        "{path} holds {found} photographs, at least {} are needed; take more, from different places",
        super::FEWEST
    )]
    TooFew { path: PathBuf, found: usize },
    #[error("{path} holds no JPEG or PNG, but {found}; convert them to JPEG")]
    OtherFormats { path: PathBuf, found: String },
    #[error("image {path} cannot be read: {source}; replace or remove it")]
    Image { path: PathBuf, source: image::ImageError },
    #[error("{dataset} holds other files ({found}); name another folder")]
    Foreign { dataset: PathBuf, found: String },
    #[error(
        "{dataset} was made of other photographs or masks; name another folder, or replace it (`dpges sfm --overwrite`), after \
         which scenes that were trained on it no longer fit it"
    )]
    Changed { dataset: PathBuf },
    #[error("{program} cannot be started: {source}; check its installation")]
    Start { program: PathBuf, source: std::io::Error },
    #[error(
        "{step}: {program} failed ({status}); {log} holds what it said, the last lines of it are\n{tail}\nThe same command \
         goes on from there, `dpges sfm --overwrite` begins anew"
    )]
    Failed { step: Step, program: PathBuf, status: String, log: PathBuf, tail: String },
    #[error(
        "no two of the {photographs} photographs show enough in common from different places, {log} says more; move \
         between photographs by less than a quarter of what they show, keep things sharp and textured, and do not only turn"
    )]
    NoModel { photographs: usize, log: PathBuf },
    #[error(
        "only {registered} of {photographs} photographs have found a place, too few for a dataset; take more, with more in \
         common from one to the next, or compare all pairs (--sfm-matching exhaustive)"
    )]
    TooFewRegistered { registered: usize, photographs: usize },
    #[error("ffmpeg has found only {found} frames in {path}, {log} says more; at least {} are needed", super::FEWEST)]
    TooFewFrames { path: PathBuf, found: usize, log: PathBuf },
    #[error(transparent)]
    Model(#[from] DatasetError),
    #[error(transparent)]
    File(#[from] dpges_core::Error),
}

/// An error of the file system as [`SfmError::File`], for `map_err`.
pub(super) fn io(action: &'static str, path: impl Into<PathBuf>) -> impl FnOnce(std::io::Error) -> SfmError {
    let path = path.into();
    move |source| SfmError::File(dpges_core::Error::Io { action, path, source })
}
