//! Counts of the requests to a device: bytes between host and device and reads that the host waits for
//! ([`transfers`]), and of a GPU also launches, times of kernels and memory (`kernels`, feature `gpu`).

#[cfg(feature = "gpu")]
pub mod kernels;
pub mod transfers;

use std::collections::BTreeMap;

use serde::Serialize;

/// Number of launches of every kernel by its name.
pub type Launches = BTreeMap<String, usize>;

/// The launches of one kernel by the clock of the device.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct KernelTime {
    /// Its module and function.
    pub kernel: String,
    /// Launches that were measured.
    pub launches: usize,
    /// Total of these launches.
    pub milliseconds: f64,
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
