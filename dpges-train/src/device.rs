//! Names of the devices a scene can be trained and rendered on.

use std::fmt;
use std::str::FromStr;

use burn::tensor::Device;

/// A device by name: `cpu` and `ndarray` are burn-ndarray, `cpu-flex` and `flex` are burn-flex.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DeviceName {
    #[cfg(feature = "ndarray")]
    NdArray,
    #[cfg(feature = "flex")]
    Flex,
}

/// Names that are accepted, for messages.
const KNOWN: &str = "cpu (burn-ndarray, also called ndarray), cpu-flex (burn-flex, also called flex)";
const CPUS: [&str; 4] = ["cpu", "ndarray", "cpu-flex", "flex"];
/// Names people try on machines with a GPU.
const GPUS: [&str; 7] = ["gpu", "wgpu", "vulkan", "metal", "cuda", "rocm", "hip"];

impl DeviceName {
    /// The device itself, without autodiff.
    pub fn open(self) -> Device {
        match self {
            #[cfg(feature = "ndarray")]
            #[expect(deprecated, reason = "burn-ndarray is deprecated upstream and supported here")]
            Self::NdArray => Device::ndarray(),
            #[cfg(feature = "flex")]
            Self::Flex => Device::flex(),
        }
    }
}

impl fmt::Display for DeviceName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            #[cfg(feature = "ndarray")]
            Self::NdArray => "cpu",
            #[cfg(feature = "flex")]
            Self::Flex => "cpu-flex",
        })
    }
}

impl FromStr for DeviceName {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            #[cfg(feature = "ndarray")]
            "cpu" | "ndarray" => Ok(Self::NdArray),
            #[cfg(feature = "flex")]
            "cpu-flex" | "flex" => Ok(Self::Flex),
            _ if CPUS.contains(&text) => {
                Err(format!("this build leaves out the backend of device `{text}`: build with its feature"))
            }
            _ if GPUS.contains(&text) => Err(format!("this build has no GPU support yet, there are: {KNOWN}")),
            _ => Err(format!("device `{text}` is unknown, there are: {KNOWN}")),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_and_aliases_are_read() {
        for (text, name) in [("cpu", "cpu"), ("ndarray", "cpu"), ("flex", "cpu-flex"), ("cpu-flex", "cpu-flex")] {
            assert_eq!(text.parse::<DeviceName>().unwrap().to_string(), name);
        }
        assert!("wgpu".parse::<DeviceName>().unwrap_err().contains("no GPU support yet"));
        assert!("tpu".parse::<DeviceName>().unwrap_err().contains("cpu-flex"));
    }
}
