//! Training of depth-peeled Gaussian-enhanced surfels from photographs.
//!
//! A [`run`] takes a [`dataset::Dataset`] through the stages of a [`config::Config`]: discs, Gaussians, then surfels and
//! Gaussians together. [`init`] makes what it begins with; [`refine`] decides which primitives come and go; [`eval`]
//! measures the scene; [`lod`] makes coarser levels of it. A [`study`] trains and measures many; [`blocks`] splits a large
//! capture into runs.
//!
//! # Dependencies
//!
//! | crate | for |
//! |---|---|
//! | burn, dpges-core | tensors, devices; the operations |
//! | burn-wgpu | feature `gpu`: the graphics adapters of the machine |
//! | glam | poses in f64 |
//! | exr | pictures of depth |
//! | icu_normalizer | names with accents that systems write differently |
//! | image, serde-ply, roxmltree | photographs; points in PLY files; cameras in XML |
//! | kamadak-exif | which camera and lens took a photograph, and how it is turned |
//! | kiddo | nearest neighbours: point spacing, margins, splits |
//! | nalgebra | eigenvectors: the normals of points, the axes of merged primitives; lenses that are fitted |
//! | moka | pictures in memory, up to a number of bytes |
//! | rand, rand_chacha | random numbers that a checkpoint can hold |
//! | rayon | reading pictures, neighbours |
//! | safetensors, serde, serde_json, toml, tempfile | checkpoints, configuration, logs |
//! | ssimulacra2 | the metric of that name |
//! | strsim | the nearest known key for an unknown one |
//! | thiserror; miette in the binary | errors |
//! | plotters, epaint_default_fonts, base64 | plots, their letters, pictures within a report |
//! | humantime | durations, the date of a report |
//! | libc | whether a signal is ignored; the end without memory (Unix) |
//! | clap, ctrlc, indicatif, tracing, tracing-indicatif, tracing-subscriber | the command line |
//! | mpi | feature `mpi`: processes that train one scene |
//! | mimalloc, libmimalloc-sys | the binary's allocator, and how long it keeps freed pages |

pub mod blocks;
pub mod config;
pub mod dataset;
pub mod device;
pub mod docs;
pub mod eval;
pub mod init;
pub mod lod;
pub mod metrics;
pub mod optimizer;
pub mod refine;
pub mod run;
mod stage;
pub mod study;
pub mod views;
