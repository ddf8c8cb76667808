//! What kind of device a tensor lives on, and how devices add up.

use std::sync::atomic::{AtomicBool, Ordering};

use burn::tensor::Device;

/// Whether `device` works on its own while the host goes on, and in f32 only: every CubeCL runtime.
pub fn is_gpu(device: &Device) -> bool {
    match device.as_dispatch().clone().inner() {
        #[cfg(feature = "gpu")]
        burn::backend::DispatchDevice::Cube(_) => true,
        _ => false,
    }
}

static DETERMINISTIC: AtomicBool = AtomicBool::new(false);

/// Fixes the order of sums on GPUs from now on, for the whole process, so that results are the same
/// bits in every run. It costs a ranking of the list of every tile, quadratic in its length.
/// CPU backends always have a fixed order.
pub fn fix_order_of_sums() {
    DETERMINISTIC.store(true, Ordering::Relaxed);
}

/// Whether [`fix_order_of_sums`] was called.
pub fn is_deterministic() -> bool {
    DETERMINISTIC.load(Ordering::Relaxed)
}
