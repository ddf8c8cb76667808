//! `dpges devices`: what scenes can be trained and shown on.

use clap::Args;
use dpges_train::device::{DeviceName, Selection, choice};
#[cfg(feature = "gpu")]
use dpges_train::device::{NO_ADAPTER_ADVICE, adapter::adapters, adapter_name::AdapterName};
use serde_json::{Value, json};

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

/// One device: as --device takes it, and for people.
struct Entry {
    name: String,
    lines: Vec<String>,
    json: Value,
}

pub fn run(args: &DevicesArgs) -> Result<()> {
    if args.auto {
        return choose(args.json);
    }
    let (cpus, gpus) = (cpus()?, gpus()?);
    let advice = gpus.is_empty().then(no_adapter);
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

fn cpus() -> Result<Vec<Entry>> {
    let names = ["cpu", "cpu-flex"].into_iter().filter_map(|name| name.parse::<DeviceName>().ok());
    let entry = |name: DeviceName| {
        let (name, backend) = (name.to_string(), name.describe()?);
        let json = json!({ "device": name, "backend": backend });
        Ok(Entry { name, lines: vec![backend], json })
    };
    names.map(entry).collect()
}

#[cfg(not(feature = "gpu"))]
fn gpus() -> Result<Vec<Entry>> {
    Ok(Vec::new())
}

#[cfg(not(feature = "gpu"))]
fn no_adapter() -> String {
    "left out of this build: build with the feature `gpu`".to_owned()
}

#[cfg(feature = "gpu")]
fn gpus() -> Result<Vec<Entry>> {
    let entries = adapters().iter().map(|adapter| {
        let name = DeviceName::Gpu(AdapterName::Number(adapter.number)).to_string();
        let shortcoming = adapter.shortcoming();
        let mut json = serde_json::to_value(adapter)?;
        json["device"] = json!(name);
        json["suitable"] = json!(shortcoming.is_none());
        json["shortcoming"] = json!(shortcoming);
        Ok(Entry { name, lines: adapter.lines(), json })
    });
    entries.collect()
}

#[cfg(feature = "gpu")]
fn no_adapter() -> String {
    format!("no graphics adapter was found: {NO_ADAPTER_ADVICE}")
}
