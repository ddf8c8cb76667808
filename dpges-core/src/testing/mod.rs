//! Shared parts of tests of this crate and of its users: golden cases, gradient checks, random and extreme scenes.

pub mod compare;
pub mod extremes;
pub mod golden;
pub mod gradients;
#[cfg(feature = "gpu")]
pub mod kernels;
pub mod lenses;
pub mod masked;
pub mod parity;
#[cfg(any(feature = "ndarray", feature = "flex"))]
pub mod precision;
pub mod random;
pub mod ranks;
pub mod scenes;

/// A CPU device that is switched on, with a tape: burn-ndarray if it is.
#[cfg(any(feature = "ndarray", feature = "flex"))]
pub fn device() -> burn::tensor::Device {
    #[cfg(feature = "ndarray")]
    return burn::tensor::Device::ndarray().autodiff();
    #[cfg(not(feature = "ndarray"))]
    crate::backend::device::cpu().autodiff()
}
