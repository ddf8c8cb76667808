//! `dpges devices`: what scenes can be trained and shown on.

use clap::Args;
use dpges_train::device::{DeviceName, Selection, auto};
#[cfg(feature = "gpu")]
use dpges_train::device::{
    NO_ADAPTER_ADVICE,
    adapter::{self, Adapter},
    choice::AdapterChoice,
};
use serde_json::{Value, json};

use super::{Result, device_choice, print, table};

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

/// One device.
struct Entry {
    /// As --device takes it.
    name: String,
    /// For people.
    lines: Vec<String>,
    json: Value,
}

pub fn run(args: &DevicesArgs) -> Result<()> {
    if args.auto {
        return choose(args.json);
    }
    let (cpus, adapters) = (cpus()?, adapters()?);
    let advice = adapters.is_empty().then(no_adapter);
    if args.json {
        let values = |entries: Vec<Entry>| entries.into_iter().map(|entry| entry.json).collect::<Vec<_>>();
        let object = json!({ "cpus": values(cpus), "adapters": values(adapters), "advice": advice });
        return print(&format!("{}\n", serde_json::to_string_pretty(&object)?));
    }
    let mut rows = Vec::new();
    for entry in cpus.iter().chain(&adapters) {
        let names = std::iter::once(entry.name.as_str()).chain(std::iter::repeat(""));
        rows.extend(names.zip(entry.lines.iter().cloned()));
    }
    rows.extend(advice.map(|advice| ("wgpu", advice)));
    print(&table(&rows))
}

/// In this process for JSON, which is what another `dpges` asks for, and so in a child process otherwise.
fn choose(json: bool) -> Result<()> {
    if json {
        return print(&format!("{}\n", serde_json::to_string(&auto::select()?)?));
    }
    let Selection { device, reason } = device_choice::automatic()?;
    print(&format!("{device}, since {reason}\n"))
}

fn cpus() -> Result<Vec<Entry>> {
    let names = ["cpu", "cpu-flex"].into_iter().filter_map(|name| name.parse::<DeviceName>().ok());
    let entry = |name: DeviceName| -> Result<Entry> {
        let (name, backend) = (name.to_string(), name.describe()?);
        let json = json!({ "device": name, "backend": backend });
        Ok(Entry { name, lines: vec![backend], json })
    };
    names.map(entry).collect()
}

#[cfg(not(feature = "gpu"))]
fn adapters() -> Result<Vec<Entry>> {
    Ok(Vec::new())
}

#[cfg(not(feature = "gpu"))]
fn no_adapter() -> String {
    "left out of this build: build with the feature `gpu`".to_owned()
}

#[cfg(feature = "gpu")]
fn adapters() -> Result<Vec<Entry>> {
    let entry = |adapter: &Adapter| -> Result<Entry> {
        let name = DeviceName::Gpu(AdapterChoice::Number(adapter.number)).to_string();
        let shortcoming = adapter.shortcoming();
        let mut json = serde_json::to_value(adapter)?;
        json["device"] = json!(name);
        json["suitable"] = json!(shortcoming.is_none());
        json["shortcoming"] = json!(shortcoming);
        Ok(Entry { name, lines: lines(adapter, shortcoming), json })
    };
    adapter::adapters().iter().map(entry).collect()
}

#[cfg(feature = "gpu")]
fn no_adapter() -> String {
    format!("no graphics adapter was found: {NO_ADAPTER_ADVICE}")
}

#[cfg(feature = "gpu")]
fn lines(adapter: &Adapter, shortcoming: Option<String>) -> Vec<String> {
    let Adapter { name, kind, api, driver, driver_info, workgroup_invocations, storage_buffers_per_stage, .. } =
        adapter;
    let mib = |bytes: u64| bytes >> 20;
    let subgroups = match adapter.subgroup_sizes {
        Some([least, most]) => format!("subgroups of {least} to {most}"),
        None => "no subgroups".to_owned(),
    };
    let atomics = if adapter.f32_atomic_add { "native" } else { "by compare-and-swap" };
    vec![
        name.clone(),
        format!("{kind}, {api}, driver {driver} {driver_info}"),
        format!(
            "storage binding {} MiB, buffer {} MiB, {storage_buffers_per_stage} storage buffers per stage",
            mib(adapter.storage_binding_bytes),
            mib(adapter.buffer_bytes)
        ),
        format!(
            "workgroup memory {} KiB, {workgroup_invocations} invocations, {subgroups}, f32 atomic add {atomics}",
            adapter.workgroup_bytes >> 10
        ),
        shortcoming.map_or_else(|| "suitable".to_owned(), |shortcoming| format!("not suitable: {shortcoming}")),
    ]
}
