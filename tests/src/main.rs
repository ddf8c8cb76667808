//! Tests that need more than one crate, files or the binary, and run on any machine. Those that need more of a machine
//! are in `machine.rs`.

mod acceptance;
mod budget;
mod devices;
mod extreme_training;
mod extremes;
mod fuzz;
mod golden;
mod invariance;
mod large;
mod long_training;
mod on_cpus;
mod poisoned;
mod precision;
mod robustness;
mod students;
mod total_gradient;
