//! How the failure of a device is told.

use dpges_train::device::DeviceName;
use dpges_train::device::failure::{DeviceFailure, Watch};

use super::{Failure, Result};

/// Returns what `work` returns, which uses `device` and leaves nothing behind if the device fails.
pub fn watched(device: DeviceName, work: impl FnOnce() -> Result<()>) -> Result<()> {
    if device.is_cpu() {
        return work();
    }
    let failed =
        |failure: DeviceFailure| Failure::with_help(format!("device `{device}` failed: {failure}"), failure.advice());
    Watch::start().catch(work).map_err(failed)?
}
