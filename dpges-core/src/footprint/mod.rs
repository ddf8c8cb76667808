//! Footprints: the value of a surfel or a Gaussian at a pixel. `peel`, `splat` and `blend` share them.
//!
//! A *splat* is the ellipse that a Gaussian projects to (EWA): `gaussian`. A *disc* is a surfel that the ray through a
//! pixel meets: `surfel`. Each has twins, `cpu` and, for GPUs, `cube`. Through a lens a Gaussian is the ellipse of the
//! lens's derivative at its centre, and a disc is met by the ray of every pixel: `rays`, and the pixels that it can reach:
//! `lens_reach`.

pub(crate) mod gaussian;
pub(crate) mod moments;
pub(crate) mod rays;
pub(crate) mod surfel;

pub use gaussian::tensors::GaussianTensors;

/// A fragment whose value is below this does not exist.
pub const CUTOFF: f64 = 1.0 / 255.0;
