//! What a piece of work asks of its device: bytes between host and device and reads that the host waits for
//! ([`transfers`]), and of a GPU also launches, times of kernels and memory (`kernels`, feature `gpu`).

#[cfg(feature = "gpu")]
pub mod kernels;
pub mod transfers;
