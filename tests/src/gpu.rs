//! The GPU that tests run on: the best that wgpu finds, a software driver where there is no other.
//!
//! `DPGES_REQUIRE_GPU=1` makes a missing adapter a failure; without it tests that need one say that
//! they were skipped.

use std::io::Write;

use burn::tensor::Device;
use dpges_train::device::DeviceName;

/// The device, or `None` where there is none and none is required.
///
/// # Panics
/// If there is none and `DPGES_REQUIRE_GPU` is 1.
pub fn gpu(test: &str) -> Option<Device> {
    let best: DeviceName = "wgpu".parse().unwrap();
    match best.describe().and_then(|adapter| Ok((adapter, best.open()?))) {
        Ok((adapter, device)) => {
            say(&format!("{test}: on {adapter}"));
            Some(device)
        }
        Err(error) => {
            let required = std::env::var("DPGES_REQUIRE_GPU").is_ok_and(|value| value == "1");
            assert!(!required, "{test}: DPGES_REQUIRE_GPU=1, and {error}");
            say(&format!("{test}: SKIPPED, {error}"));
            None
        }
    }
}

/// Past the capture of the test harness: a skipped test is not to look like one that passed.
fn say(line: &str) {
    let _ = writeln!(std::io::stderr().lock(), "{line}");
}
