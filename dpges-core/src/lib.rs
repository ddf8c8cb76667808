//! Differentiable rendering of depth-peeled surfels and sort-free Gaussians as Burn operations.
#![cfg_attr(feature = "ndarray", expect(deprecated, reason = "burn-ndarray is deprecated upstream and supported here"))]
#![recursion_limit = "256"]

pub mod atomic;
pub mod camera;
pub mod error;
mod host;
pub mod losses;
mod math;
pub mod metrics;
pub mod ops;
mod real;
pub mod render;
pub mod scene;
mod simd;
pub mod tensor_file;
#[cfg(any(test, feature = "testing"))]
pub mod testing;

pub use error::{Error, Result};
