//! What kind of device a tensor lives on.

use burn::tensor::Device;

/// Whether `device` works on its own while the host goes on, and in f32 only: every CubeCL runtime.
pub fn is_gpu(device: &Device) -> bool {
    match device.as_dispatch().clone().inner() {
        #[cfg(feature = "gpu")]
        burn::backend::DispatchDevice::Cube(_) => true,
        _ => false,
    }
}
