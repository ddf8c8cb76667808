//! The custom operations, in the order in which a training step uses them: [`finite`], [`colour`],
//! [`peel`], [`visibility`](mod@visibility), [`splat`], [`composite`], [`environment`](mod@environment),
//! [`photometric`], [`surfel_loss`], [`scale_loss`], [`adam`]. [`coverage`] and [`jitter`] serve refinement, and
//! [`unpack`](mod@unpack) brings photographs and masks to a GPU.
//! [`blend`] replaces peel, splat and composite where Gaussians or discs are trained alone, [`harmonics`](mod@harmonics)
//! and `splat` where they are summed.
//!
//! Every folder has the same files:
//!
//! | file | holds |
//! |---|---|
//! | `mod.rs` | the contract (shapes, units, source, which gradients exist) and the public function |
//! | `cpu.rs` | kernels of the CPU backends |
//! | `cube.rs` | their CubeCL twins for GPUs |
//! | `autodiff.rs` | the operation on Burn's tape, and what it keeps for the backward pass, which the kernels implement |
//! | `tests.rs` | what only this operation needs; `fixtures.rs` has what several need |
//!
//! A file that grew too long has a folder of its name beside it. A new operation copies the shape of
//! `colour`, the smallest that has them all. Operations use the rooms below them: `binning`, below that
//! `footprint`, below that `gpu` and `tiles`. None of these knows an operation.
//!
//! # Arguments
//!
//! Every public function takes its arguments in the same order: structs of tensors, tensors, camera, options.
//! All are taken by reference; numbers and choices without fields are taken by value. Only
//! [`adam_step`](adam::adam_step) takes tensors by value: it changes them in place and returns them.
//!
//! Images are planar, [C, H, W], row-major; per-layer images are [K, H, W].

pub mod adam;
pub mod blend;
pub mod colour;
pub mod composite;
pub mod coverage;
pub mod environment;
pub mod finite;
#[cfg(test)]
pub(crate) mod fixtures;
pub mod harmonics;
pub mod jitter;
pub mod peel;
pub mod photometric;
pub mod scale_loss;
pub mod splat;
pub mod surfel_loss;
pub mod unpack;
pub mod visibility;
