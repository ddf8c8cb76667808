//! Devices: the CPU, and whether a device is a GPU.

use burn::tensor::Device;

/// The CPU, by burn-flex, or by burn-ndarray without the feature `flex`. Burn's own default device is a GPU wherever
/// the feature `gpu` is on.
#[cfg(any(feature = "ndarray", feature = "flex"))]
pub fn cpu() -> Device {
    #[cfg(feature = "flex")]
    return Device::flex();
    #[cfg(not(feature = "flex"))]
    Device::ndarray()
}

/// Whether `device` works on its own while the host goes on, and in f32 only: every CubeCL runtime.
pub fn is_gpu(device: &Device) -> bool {
    match device.as_dispatch().clone().inner() {
        #[cfg(feature = "gpu")]
        burn::backend::DispatchDevice::Cube(_) => true,
        _ => false,
    }
}

/// Bytes of the largest buffer that `device` takes; no limit on a CPU.
pub fn largest_buffer(device: &Device) -> usize {
    match device.as_dispatch().clone().inner() {
        #[cfg(feature = "gpu")]
        burn::backend::DispatchDevice::Cube(device) => {
            crate::gpu::launch::largest_page(device.client().properties().memory.max_page_size)
        }
        _ => usize::MAX,
    }
}
