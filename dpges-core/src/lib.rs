//! Differentiable rendering of depth-peeled surfels and sort-free Gaussians as Burn operations.
//!
//! [`render::render`] turns [`scene::Surfels`] and [`scene::Gaussians`] seen by a [`camera::Camera`] into an image;
//! [`render::blended::render_blended`] does so with Gaussians or discs alone, in the order of their depths. [`losses`]
//! compares it with a photograph; [`ops`] holds the operations all are made of.
//!
//! Conventions: camera axes x right, y down, z forward; pixel (column i, row j) sampled at (i + 0.5, j + 0.5); depth is
//! camera-space z in world units; quaternions (w, x, y, z), raw; scales as natural logarithms; linear opacity.
//! Shape letters: N surfels, M Gaussians, K layers, H × W pixels; images are planar, [C, H, W].
//!
//! Without the feature `burn`, which every backend switches on, there are [`camera`], [`mod@scene`] in host memory, and its
//! file: what a renderer needs that does not differentiate.
//!
//! # Dependencies
//!
//! | crate | for |
//! |---|---|
//! | burn | feature `burn`: tensors, tape, backends |
//! | glam | cameras in f64 |
//! | num-traits, bytemuck | kernels generic over f32 and f64 on tensors viewed as slices |
//! | rayon, pulp | threads; the vector instructions of the machine, chosen at run time |
//! | safetensors, serde, serde_json, tempfile | the scene file, written whole or not at all |
//! | miniz_oxide | deflate in compressed scenes, both ways, in Rust without unsafe code, in browsers too. Its input is mostly noise, for which Huffman codes come within 2 % of the entropy of the bytes: a better search for repetitions gains little |
//! | thiserror | errors |
//! | burn-cubecl, cubecl | feature `gpu`: kernels for any GPU that wgpu reaches |
//! | tracing | feature `gpu`: a note when a buffer had to grow |
//! | burn-optim, image | the examples: an optimiser of Burn, a PNG |
#![cfg_attr(feature = "ndarray", expect(deprecated, reason = "burn-ndarray is deprecated upstream and supported here"))]
#![recursion_limit = "256"]

#[cfg(feature = "burn")]
pub mod backend;
pub mod camera;
#[cfg(feature = "burn")]
pub mod counters;
pub mod docs;
pub mod error;
#[cfg(feature = "burn")]
pub mod footprint;
#[cfg(feature = "gpu")]
mod gpu;
#[cfg(feature = "burn")]
pub mod losses;
#[cfg(feature = "burn")]
mod math;
#[cfg(feature = "burn")]
pub mod ops;
#[cfg(feature = "burn")]
pub mod ranks;
#[cfg(feature = "burn")]
pub mod render;
pub mod scene;
#[cfg(any(test, feature = "selftest"))]
pub mod testing;
#[cfg(feature = "burn")]
pub mod tiles;

pub use camera::{Camera, CameraFromWorld};
pub use error::{Error, Result};
#[cfg(feature = "burn")]
pub use render::blended::{BlendedOptions, render_blended};
#[cfg(feature = "burn")]
pub use render::{Render, RenderOptions, render};
#[cfg(feature = "burn")]
pub use scene::{Colour, Gaussians, Surfels};
pub use scene::{ColourData, ColourModel, EnvironmentData, GaussianData, SceneData, SceneInfo, SurfelData};
#[cfg(feature = "burn")]
pub use tiles::capacity::within_capacity;
