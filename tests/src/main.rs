//! Tests that need more than one crate, files or the binary.

mod acceptance;
mod devices;
mod golden;
mod invariance;
mod robustness;
mod total_gradient;
