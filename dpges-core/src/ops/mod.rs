//! The custom operations, in the order in which a training step uses them: [`finite`], [`colour`],
//! [`peel`], [`limits`], [`splat`], [`composite`], [`ssim`], [`adam`]; [`coverage`] serves refinement; [`blend`]
//! takes the place of peel, splat and composite where Gaussians or discs are trained alone. Arrows point
//! down: operations → `binning` → `footprint` → `gpu` and `tiles`.
//!
//! Each folder has the same files: `mod.rs` is the contract (shapes, units, which gradients exist,
//! source) and the public function, `cpu.rs` the kernels of the CPU backends, `cube.rs` their CubeCL
//! twins for GPUs, `backward.rs` the registration with Burn's tape, `tests.rs` what only this
//! operation needs. To add an operation, copy the shape of `colour`, the smallest that has them all.
//!
//! Images are planar, [C, H, W], row-major; per-layer images are [K, H, W].

pub mod adam;
pub mod blend;
pub mod colour;
pub mod composite;
pub mod coverage;
pub mod finite;
pub mod limits;
pub mod peel;
pub mod splat;
pub mod ssim;
