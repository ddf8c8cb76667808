//! Counts of the requests to a device: bytes between host and device and reads that the host waits for
//! ([`transfers`]), and of a GPU also launches, times of kernels and memory (`kernels`, feature `gpu`).

#[cfg(feature = "gpu")]
pub mod kernels;
pub mod transfers;

use std::collections::BTreeMap;

use serde::Serialize;

/// The requests of a piece of work to a GPU.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct GpuWork {
    /// By module and function.
    pub kernels: BTreeMap<String, KernelWork>,
    pub memory: DeviceMemory,
}

/// The launches of one kernel.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct KernelWork {
    pub launches: usize,
    /// All of them, by the clock of the device; `None` where the adapter has no timestamps.
    pub milliseconds: Option<f64>,
}

/// Memory that CubeCL holds on a device, bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct DeviceMemory {
    /// In buffers that are alive before the work.
    pub alive_bytes: u64,
    /// Most in buffers that are alive at a launch.
    pub peak_bytes: u64,
    /// Allocated from the driver after the work, with what is kept for later buffers.
    pub reserved_bytes: u64,
}
