//! Training of depth-peeled Gaussian-enhanced surfels from photographs.

pub mod checkpoint;
pub mod config;
pub mod dataset;
pub mod device;
pub mod eval;
pub mod init;
pub mod metrics_log;
pub mod neighbours;
pub mod optimizer;
pub mod pictures;
pub mod refine;
pub mod run_folder;
pub mod scene_state;
pub mod trainer;

/// The example of the README, compiled.
#[cfg(doctest)]
#[doc = include_str!("../../README.md")]
struct Readme;
