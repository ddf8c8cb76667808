//! Tests that need more than one crate, files or the binary.

mod acceptance;
mod devices;
mod golden;
mod gpu;
mod invariance;
mod parity;
mod robustness;
mod total_gradient;
mod training;
