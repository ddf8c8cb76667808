//! Errors in the arguments of a caller; every message names the tensor, option or file.

use std::path::PathBuf;

pub type Result<T, E = Error> = std::result::Result<T, E>;

#[derive(Debug, thiserror::Error)]
pub enum Error {
    #[error("tensor `{tensor}` has shape {found:?}, expected {expected}")]
    Shape { tensor: String, expected: String, found: Vec<usize> },
    #[error("tensor `{tensor}` is not finite at row {row}, expected finite numbers")]
    NonFinite { tensor: String, row: usize },
    #[error("tensor `{tensor}` has element type {found}, expected {expected}")]
    DType { tensor: String, expected: String, found: String },
    #[error("camera `{field}` is {found}, expected {expected}")]
    Camera { field: &'static str, expected: &'static str, found: String },
    #[error("option `{option}` is {found}, expected {expected}")]
    Option { option: &'static str, expected: String, found: String },
    #[error(
        "{what} takes {needed} bytes, and a buffer has at most {largest}: render smaller images or fewer primitives"
    )]
    Capacity { what: String, needed: u64, largest: u64 },
    #[error("the device failed: {reason}")]
    Device { reason: String },
    #[error("scene file {path}: {reason}")]
    SceneFile { path: PathBuf, reason: String },
    #[error("{action} {path}: {source}")]
    Io { action: &'static str, path: PathBuf, source: std::io::Error },
}
