//! `dpges selftest`: whether a device computes correctly.

use std::time::Instant;

use burn::tensor::Device;
use clap::{Args, value_parser};
use dpges_train::device::failure::Watch;
use dpges_train::device::selftest::{CASES, Report};
use dpges_train::device::{DeviceName, DeviceRequest, extremes};
use indicatif::ProgressBar;

use super::{Failure, Result, device_choice, print_either, table};

/// Check that a device computes correctly
///
/// Renders small scenes on the device in f32 and compares pictures, losses and gradients with those of the model's
/// float64 specification, which are part of the program. Exits with 1 if the error of any is too large.
///
/// With --extremes, random scenes at the extremes instead (needles, discs seen edge-on, huge and tiny worlds and scales,
/// 0.1° and 179° of view, …), rendered and differentiated in f32 on the device and in f64 on the CPU. Prints how far the
/// two are apart, as tables in Markdown. Exits with 1 if any value is not finite.
#[derive(Debug, Args)]
pub struct SelftestArgs {
    /// auto (a GPU that passes a check, or else the CPU), cpu, wgpu (the best GPU), or another one that
    /// `dpges devices` lists
    #[arg(long, value_name = "NAME", default_value = "wgpu")]
    device: DeviceRequest,
    /// Render N random scenes at the extremes
    #[arg(long, value_name = "N", value_parser = value_parser!(u64).range(1..))]
    extremes: Option<u64>,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

pub fn run(args: &SelftestArgs) -> Result<()> {
    let name = device_choice::select(args.device)?;
    let device = name.open()?;
    let description = name.describe()?;
    if let Some(count) = args.extremes {
        return at_extremes(count, name, &device, &description, args.json);
    }
    let start = Instant::now();
    let findings = Watch::start()
        .catch(|| CASES.iter().flat_map(|case| case.check(&device)).collect::<Vec<_>>())
        .map_err(|failure| Failure::with_help(format!("{description} failed: {failure}"), advice(name)))?;
    let report = Report::new(name.to_string(), description, &findings, start.elapsed().as_secs_f64());
    print_either(args.json, &report, &table(&report.rows()))?;
    if report.passed {
        return Ok(());
    }
    let message = format!("{} computes {} of {} tensors wrongly", report.description, report.wrong, report.tensors);
    Err(Failure::with_help(message, advice(name)))
}

fn at_extremes(count: u64, name: DeviceName, device: &Device, description: &str, json: bool) -> Result<()> {
    let progress = ProgressBar::new(count);
    let found = Watch::start()
        .catch(|| extremes::measure(count, device, description, || progress.inc(1)))
        .map_err(|failure| Failure::with_help(format!("{description} failed: {failure}"), advice(name)))??;
    progress.finish_and_clear();
    print_either(json, &found, &found.markdown())?;
    match found.non_finite {
        0 => Ok(()),
        count => {
            let message = format!("{count} tensors have values that are not finite");
            Err(Failure::with_help(message, "please report it with the table above"))
        }
    }
}

fn advice(device: DeviceName) -> &'static str {
    if device.is_cpu() {
        "this is a fault of the program or of this build: please report it with the table above"
    } else {
        "do not train on it: update its driver, or try another --device (`dpges devices`; `cpu` works everywhere); \
         please report it with what `dpges devices` says"
    }
}
