//! Training of depth-peeled Gaussian-enhanced surfels from photographs.
//!
//! A [`run`] takes a [`dataset::Dataset`] through the stages of a [`config::Config`]: discs, Gaussians, then surfels and
//! Gaussians together. [`init`] makes what it begins with; [`refine`] decides which primitives come and go; [`eval`]
//! measures the scene. The crate dpges-lab is for what is made of many runs.
//!
//! # Dependencies
//!
//! | crate | for |
//! |---|---|
//! | burn, dpges-core, dpges-data | tensors, devices; the operations; datasets |
//! | burn-wgpu | feature `gpu`: the graphics adapters of the machine |
//! | glam | poses in f64 |
//! | exr | pictures of depth |
//! | image | pictures in files |
//! | nalgebra | eigenvectors: the normals of points |
//! | rand, rand_chacha | random numbers that a checkpoint can hold |
//! | rayon | what is computed in parallel on the host |
//! | safetensors, serde, serde_json, toml, tempfile | checkpoints, configuration, logs |
//! | ssimulacra2 | the metric of that name |
//! | strsim | the nearest known key for an unknown one |
//! | thiserror | errors |
//! | humantime | durations |
//! | libc | whether a signal is ignored; the end without memory (Unix) |
//! | clap, ctrlc, tracing | values that the command line names; interruptions; messages |
//! | mpi | feature `mpi`: processes that train one scene |
//! | mimalloc | the allocator of programs |

pub mod config;
pub mod device;
pub mod docs;
pub mod eval;
pub mod init;
pub mod metrics;
pub mod optimizer;
pub mod refine;
pub mod run;
mod stage;
pub mod views;

pub use dpges_data as dataset;
