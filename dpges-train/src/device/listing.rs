//! All devices of this machine, for people and programs.

use serde_json::{Value, json};

use super::{DeviceError, DeviceName};
#[cfg(feature = "gpu")]
use super::{NO_ADAPTER_ADVICE, adapter::adapters, adapter_name::AdapterName};

/// One device: as `--device` takes it, and for people.
#[derive(Clone, Debug)]
pub struct Entry {
    pub name: String,
    pub lines: Vec<String>,
    pub json: Value,
}

/// The backends that compute on the CPU.
///
/// # Errors
/// [`DeviceError`] if one cannot be opened.
pub fn cpus() -> Result<Vec<Entry>, DeviceError> {
    let names = ["cpu", "cpu-ndarray"].into_iter().filter_map(|name| name.parse::<DeviceName>().ok());
    let entry = |name: DeviceName| {
        let (name, backend) = (name.to_string(), name.describe()?);
        let json = json!({ "device": name, "backend": backend });
        Ok(Entry { name, lines: vec![backend], json })
    };
    names.map(entry).collect()
}

/// The graphics adapters.
#[cfg(feature = "gpu")]
pub fn gpus() -> Vec<Entry> {
    let entries = adapters().iter().map(|adapter| {
        let name = DeviceName::Gpu(AdapterName::Number(adapter.number)).to_string();
        let shortcoming = adapter.shortcoming();
        let mut json = json!(adapter);
        json["device"] = json!(name);
        json["suitable"] = json!(shortcoming.is_none());
        json["shortcoming"] = json!(shortcoming);
        Entry { name, lines: adapter.lines(), json }
    });
    entries.collect()
}

#[cfg(not(feature = "gpu"))]
pub fn gpus() -> Vec<Entry> {
    Vec::new()
}

/// Advice for a machine without a graphics adapter.
pub fn advice_without_gpu() -> String {
    #[cfg(feature = "gpu")]
    return format!("no graphics adapter was found: {NO_ADAPTER_ADVICE}");
    #[cfg(not(feature = "gpu"))]
    return "left out of this build: build with the feature `gpu`".to_owned();
}
