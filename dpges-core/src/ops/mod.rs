//! The custom operations, in the order in which a training step uses them: [`finite`], [`colour`],
//! [`peel`], [`splat`], [`composite`], [`ssim`], [`adam`]; [`coverage`] and [`jitter`] serve refinement; [`blend`]
//! takes the place of peel, splat and composite where Gaussians or discs are trained alone; [`binning`],
//! [`bands`] and, on GPUs, `boxes` are shared.
//!
//! Each folder has the same files: `mod.rs` is the contract (shapes, units, which gradients exist,
//! source) and the public function, `cpu.rs` the kernels of the CPU backends, `cube.rs` their CubeCL
//! twins for GPUs, `backward.rs` the registration with Burn's tape, `tests.rs` what only this
//! operation needs. To add an operation, copy the shape of `colour`, the smallest that has them all.
//!
//! Images are planar, [C, H, W], row-major; per-layer images are [K, H, W].

pub mod adam;
pub mod bands;
pub mod binning;
pub mod blend;
#[cfg(feature = "gpu")]
mod boxes;
pub mod colour;
pub mod composite;
pub mod coverage;
pub mod finite;
pub mod jitter;
pub mod peel;
pub mod splat;
pub mod ssim;
