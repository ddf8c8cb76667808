//! What tests of this crate and of its users share: golden cases, gradient checks, random scenes.

pub mod compare;
pub mod golden;
pub mod gradients;
pub mod parity;
pub mod random;
pub mod scenes;

/// A CPU device that is switched on, with a tape.
#[cfg(any(feature = "ndarray", feature = "flex"))]
pub fn device() -> burn::tensor::Device {
    crate::device::cpu().autodiff()
}
