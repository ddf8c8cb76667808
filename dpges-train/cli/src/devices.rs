//! `dpges devices`: what scenes can be trained and shown on.

use clap::Args;
use dpges_train::device::listing::{Entry, advice_without_gpu, cpus, gpus};
use dpges_train::device::{Selection, choice};
use serde_json::json;

use super::{Result, device_choice, print, print_json, table};

/// List the devices that --device accepts
///
/// For each graphics adapter: its kind, graphics API, driver and limits, and whether the kernels run on it.
#[derive(Debug, Args)]
pub struct DevicesArgs {
    /// Say instead which device `--device auto` stands for, and why; checks GPUs, which takes a few seconds
    #[arg(long)]
    auto: bool,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

pub fn run(args: &DevicesArgs) -> Result<()> {
    if args.auto {
        return choose(args.json);
    }
    let (cpus, gpus) = (cpus()?, gpus());
    let advice = gpus.is_empty().then(advice_without_gpu);
    if args.json {
        let values = |entries: Vec<Entry>| entries.into_iter().map(|entry| entry.json).collect::<Vec<_>>();
        return print_json(&json!({ "cpus": values(cpus), "adapters": values(gpus), "advice": advice }));
    }
    let mut rows = Vec::new();
    for entry in cpus.iter().chain(&gpus) {
        let names = std::iter::once(entry.name.as_str()).chain(std::iter::repeat(""));
        rows.extend(names.zip(entry.lines.iter().cloned()));
    }
    rows.extend(advice.map(|advice| ("wgpu", advice)));
    print(&table(&rows))
}

/// In this process for JSON, which is what another `dpges` asks for in a line, and so in a child process otherwise.
fn choose(json: bool) -> Result<()> {
    if json {
        return print(&format!("{}\n", serde_json::to_string(&choice::select()?)?));
    }
    let Selection { device, reason } = device_choice::automatic()?;
    print(&format!("{device}, since {reason}\n"))
}
