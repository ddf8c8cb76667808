//! Golden cases, random and extreme scenes (feature `selftest`), gradient checks and other shared parts of tests (feature `testing`).

pub mod compare;
pub mod extremes;
pub mod golden;
#[cfg(any(test, feature = "testing"))]
pub mod gradients;
#[cfg(all(feature = "gpu", any(test, feature = "testing")))]
pub mod kernels;
#[cfg(any(test, feature = "testing"))]
pub mod lenses;
#[cfg(any(test, feature = "testing"))]
pub mod masked;
#[cfg(any(test, feature = "testing"))]
pub mod parity;
#[cfg(any(feature = "ndarray", feature = "flex"))]
pub mod precision;
pub mod random;
#[cfg(any(test, feature = "testing"))]
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
