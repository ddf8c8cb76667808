//! Which device a command runs on, the line that says so, and how its failure is told.

use clap::Args;
use dpges_train::device::failure::{DeviceFailure, Watch};
use dpges_train::device::probe::select_in_child;
use dpges_train::device::ranks::Job;
use dpges_train::device::{DeviceName, DeviceRequest, Selection};

use super::{Failure, Result};

/// The option of commands that use one device.
#[derive(Clone, Copy, Debug, Args)]
pub struct DeviceArgs {
    /// auto (a GPU that passes a check, or else the CPU), cpu, wgpu (the best GPU), or another one that
    /// `dpges devices` lists
    #[arg(long = "device", value_name = "NAME", default_value_t)]
    pub request: DeviceRequest,
}

/// The device that is asked for; says which and why.
pub fn select(request: DeviceRequest) -> Result<DeviceName> {
    match request {
        DeviceRequest::Auto => {
            let Selection { device, reason } = automatic()?;
            tracing::info!("device: {device}, since {reason}");
            Ok(device)
        }
        DeviceRequest::Named(device) => said(device, "as --device says"),
    }
}

/// As [`select`] for a run that goes on: the device it was started on, unless another one is asked for.
pub fn select_again(request: Option<DeviceRequest>, started_on: &str) -> Result<DeviceName> {
    match request {
        Some(request) => select(request),
        None => said(started_on.parse().map_err(Failure::Usage)?, "as before"),
    }
}

/// The device of this rank of `job`, which runs on `device`; `request` is what was asked for.
pub fn of_rank(job: &Job, device: DeviceName, request: Option<DeviceRequest>) -> Result<DeviceName> {
    let own = job.device(device, matches!(request, Some(DeviceRequest::Named(_))));
    if own == device { Ok(device) } else { said(own, "as the number of this rank on its machine says") }
}

fn said(device: DeviceName, why: &str) -> Result<DeviceName> {
    let description = device.describe()?;
    tracing::info!("device: {device} ({description}), {why}");
    Ok(device)
}

/// The device that `auto` stands for.
pub fn automatic() -> Result<Selection> {
    Ok(select_in_child(&["devices", "--auto", "--json"])?)
}

/// Returns what `work` returns, which uses `device` and leaves nothing behind if the device fails.
pub fn watched(device: DeviceName, work: impl FnOnce() -> Result<()>) -> Result<()> {
    if device.is_cpu() {
        return work();
    }
    let failed =
        |failure: DeviceFailure| Failure::with_help(format!("device `{device}` failed: {failure}"), failure.advice());
    Watch::start().catch(work).map_err(failed)?
}
