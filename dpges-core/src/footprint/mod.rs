//! What a surfel or a Gaussian is at a pixel: shared by `peel`, `splat` and `blend`.
//!
//! [`splat`] and [`disc`] are the CPU's, `splat_cube` and `disc_cube` their twins for GPUs. A *splat* is a Gaussian
//! projected as a whole (EWA); a *disc* is a surfel met by the ray through a pixel.

pub(crate) mod disc;
#[cfg(feature = "gpu")]
pub(crate) mod disc_cube;
pub(crate) mod gaussians;
pub(crate) mod splat;
#[cfg(feature = "gpu")]
pub(crate) mod splat_cube;

/// A fragment whose value is below this does not exist.
pub const CUTOFF: f64 = 1.0 / 255.0;
