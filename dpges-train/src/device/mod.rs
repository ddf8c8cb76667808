//! Devices that scenes can be trained and rendered on, by name.

#[cfg(feature = "gpu")]
pub mod adapter;
pub mod adapter_name;
pub mod allocator;
pub mod choice;
pub mod extremes;
pub mod failure;
pub mod listing;
pub mod memory;
pub mod place;
pub mod probe;
pub mod ranks;
pub mod selftest;

use std::fmt;
use std::str::FromStr;

use burn::tensor::Device;

use adapter_name::AdapterName;
pub use choice::{DeviceRequest, Selection};

/// The name of a device: `cpu` and `flex` are burn-flex, `cpu-ndarray` and `ndarray` are burn-ndarray. All others are
/// graphics adapters, see [`AdapterName`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DeviceName {
    #[cfg(feature = "flex")]
    Flex,
    #[cfg(feature = "ndarray")]
    NdArray,
    #[cfg(feature = "gpu")]
    Gpu(AdapterName),
}

/// Why a device cannot be used, and what to do.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum DeviceError {
    #[error("no graphics adapter was found for device `{asked}`: {}", NO_ADAPTER_ADVICE)]
    NoAdapter { asked: AdapterName },
    #[error("there is no device `{asked}`, there are: {found}; `dpges devices` says more about them")]
    NoMatch { asked: AdapterName, found: String },
    #[error("device `{asked}` is {adapter}, where the kernels do not run: {shortcoming}; `dpges devices` lists others")]
    Unsuitable { asked: AdapterName, adapter: String, shortcoming: String },
    #[error("{adapter} cannot be opened: {reason}; update its driver, or name another device (`dpges devices`)")]
    Refused { adapter: String, reason: String },
    #[error("there is no device to choose: {reason}, and this build leaves the CPU backends out")]
    NoCpu { reason: String },
}

/// Advice for a machine without any adapter.
pub const NO_ADAPTER_ADVICE: &str = "install the driver of the GPU (on Linux with Vulkan; where there is no GPU, \
                                     Debian's mesa-vulkan-drivers and libvulkan1 do its work on the CPU), or use \
                                     `--device cpu`";

/// The accepted names, for messages.
const KNOWN: &str = "auto (a GPU that passes a check, or else the CPU), cpu, wgpu (the best GPU), and what else \
                     `dpges devices` lists";
const CPUS: [&str; 4] = ["cpu", "flex", "cpu-ndarray", "ndarray"];
/// Names of other ways to a GPU, which people try.
const OTHER_GPUS: [&str; 3] = ["cuda", "rocm", "hip"];

impl DeviceName {
    /// The device itself, without autodiff. A GPU is started the first time and shared from then on.
    ///
    /// # Errors
    /// [`DeviceError`] if there is no such adapter, the kernels do not run on it, or its driver refuses it.
    pub fn open(self) -> Result<Device, DeviceError> {
        match self {
            #[cfg(feature = "ndarray")]
            #[expect(deprecated, reason = "burn-ndarray is deprecated upstream and supported here")]
            Self::NdArray => Ok(Device::ndarray()),
            #[cfg(feature = "flex")]
            Self::Flex => Ok(Device::flex()),
            #[cfg(feature = "gpu")]
            Self::Gpu(name) => name.pick(adapter::adapters())?.open(),
        }
    }

    /// The wgpu objects of a GPU that was [opened](Self::open), for drawing on the device that Burn uses.
    #[cfg(feature = "gpu")]
    pub fn wgpu_setup(self) -> Option<&'static burn_wgpu::WgpuSetup> {
        match self {
            Self::Gpu(name) => name.pick(adapter::adapters()).ok()?.setup(),
            #[cfg(any(feature = "ndarray", feature = "flex"))]
            _ => None,
        }
    }

    /// Whether the device is a CPU backend. A software adapter counts as a GPU.
    pub fn is_cpu(self) -> bool {
        match self {
            #[cfg(feature = "ndarray")]
            Self::NdArray => true,
            #[cfg(feature = "flex")]
            Self::Flex => true,
            #[cfg(feature = "gpu")]
            Self::Gpu(_) => false,
        }
    }

    /// Whether the device is a driver that emulates a GPU on the CPU, where times say nothing about GPUs.
    pub fn is_software(self) -> bool {
        match self {
            #[cfg(feature = "gpu")]
            Self::Gpu(name) => {
                name.pick(adapter::adapters()).is_ok_and(|adapter| adapter.kind == adapter_name::Kind::Software)
            }
            #[cfg(any(feature = "ndarray", feature = "flex"))]
            _ => false,
        }
    }

    /// The device of this name on this machine, as text for people.
    ///
    /// # Errors
    /// [`DeviceError`] if there is no such adapter or the kernels do not run on it.
    pub fn describe(self) -> Result<String, DeviceError> {
        match self {
            #[cfg(feature = "ndarray")]
            Self::NdArray => Ok("burn-ndarray on the CPU".to_owned()),
            #[cfg(feature = "flex")]
            Self::Flex => Ok("burn-flex on the CPU".to_owned()),
            #[cfg(feature = "gpu")]
            Self::Gpu(name) => name.pick(adapter::adapters()).map(ToString::to_string),
        }
    }
}

/// Text that [`FromStr`] reads back.
impl fmt::Display for DeviceName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            #[cfg(feature = "flex")]
            Self::Flex => f.write_str("cpu"),
            #[cfg(feature = "ndarray")]
            Self::NdArray => f.write_str("cpu-ndarray"),
            #[cfg(feature = "gpu")]
            Self::Gpu(name) => name.fmt(f),
        }
    }
}

impl FromStr for DeviceName {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match (text, AdapterName::parse(text)) {
            #[cfg(feature = "flex")]
            ("cpu" | "flex", _) => Ok(Self::Flex),
            #[cfg(feature = "ndarray")]
            ("cpu-ndarray" | "ndarray", _) => Ok(Self::NdArray),
            #[cfg(feature = "gpu")]
            (_, Some(name)) => Ok(Self::Gpu(name)),
            (_, name) if name.is_some() || CPUS.contains(&text) => Err(format!(
                "this build leaves out the backend of device `{text}`: build with its feature (flex, ndarray or gpu)"
            )),
            _ if OTHER_GPUS.contains(&text) => Err(format!(
                "there is no device `{text}`: every GPU is reached through wgpu, the best one as `wgpu`, each as \
                 `dpges devices` lists it"
            )),
            _ => Err(format!("device `{text}` is unknown, there are: {KNOWN}")),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_and_aliases_are_read() {
        let named = [("cpu", "cpu"), ("flex", "cpu")].into_iter();
        let with_ndarray = [("ndarray", "cpu-ndarray"), ("cpu-ndarray", "cpu-ndarray")].into_iter();
        for (text, name) in named.chain(with_ndarray.filter(|_| cfg!(feature = "ndarray"))) {
            let device = text.parse::<DeviceName>().unwrap();
            assert!(device.is_cpu());
            assert_eq!(device.to_string(), name);
        }
        assert!("cuda".parse::<DeviceName>().unwrap_err().contains("through wgpu"));
        for text in ["tpu", "wgpu:", "wgpu:first", "vulkan:0", "cpu:0"] {
            let error = text.parse::<DeviceName>().unwrap_err();
            assert!(error.contains(text) && error.contains("cpu, wgpu"), "{error}");
        }
    }

    #[cfg(feature = "gpu")]
    #[test]
    fn names_of_gpus_are_read_back() {
        let kinds = ["discrete", "integrated:1", "virtual", "other", "software:0"];
        let apis = ["vulkan", "metal", "dx12", "gl"];
        for text in kinds.into_iter().chain(apis).chain(["wgpu", "wgpu:12"]) {
            let device = text.parse::<DeviceName>().unwrap();
            assert!(!device.is_cpu());
            assert_eq!(device.to_string(), text);
        }
        assert_eq!("gpu".parse::<DeviceName>().unwrap().to_string(), "wgpu");
    }
}
