//! Tests that need more than one crate, files or the binary, and run on any machine. Those that need more of a machine
//! are in `machine.rs`.

mod acceptance;
mod devices;
mod extremes;
mod fuzz;
mod golden;
mod invariance;
mod long_training;
mod precision;
mod robustness;
mod total_gradient;
