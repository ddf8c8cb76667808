//! Footprints: the value of a surfel or a Gaussian at a pixel. `peel`, `splat` and `blend` share them.
//!
//! A *splat* is the ellipse that a Gaussian projects to (EWA). A *disc* is a surfel that the ray through a pixel
//! meets. `splat` and `disc` run on CPUs; `splat_cube` and `disc_cube` are their twins for GPUs. Through a lens a
//! Gaussian is the ellipse of the lens's derivative at its centre, and a disc is met by the ray of every pixel: `rays`, and
//! the pixels that it can reach: `lens_reach`.

pub(crate) mod disc;
#[cfg(feature = "gpu")]
pub(crate) mod disc_cube;
pub(crate) mod gaussians;
pub(crate) mod lens_reach;
pub(crate) mod moments;
pub(crate) mod rays;
#[cfg(feature = "gpu")]
pub(crate) mod regions_cube;
pub(crate) mod splat;
#[cfg(feature = "gpu")]
pub(crate) mod splat_cube;

pub use gaussians::GaussianTensors;

/// A fragment whose value is below this does not exist.
pub const CUTOFF: f64 = 1.0 / 255.0;
