//! How much memory photographs may take.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use super::budget::MEGABYTE;
use super::declare::{text, value};
use crate::device::memory::machine_memory_bytes;

/// Bytes.
const GIGABYTE: f64 = 1000.0 * MEGABYTE;
/// Share of the memory of the machine.
const SHARE: f64 = 0.25;
/// Where the memory of the machine is not known.
const UNKNOWN_MACHINE: f64 = 4.0 * GIGABYTE;

/// Most memory for photographs.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub enum Memory {
    /// A quarter of the memory of the machine.
    Auto,
    /// In units of 10⁶ bytes; finite and at least 0.
    Megabytes(f64),
    /// In units of 10⁹ bytes; finite and at least 0.
    Gigabytes(f64),
}

value!(
    Memory, "a string", toml::Value::is_str,
    "auto" => "A quarter of the memory of the machine; 1GB where that is not known.",
    "NMB" => "N million bytes.",
    "NGB" => "N thousand million bytes."
);
text!(Memory);

impl Memory {
    pub fn bytes(self) -> usize {
        let bytes = match self {
            Self::Auto => SHARE * machine_memory_bytes().map_or(UNKNOWN_MACHINE, |bytes| bytes as f64),
            Self::Megabytes(size) => MEGABYTE * size,
            Self::Gigabytes(size) => GIGABYTE * size,
        };
        bytes as usize
    }
}

impl fmt::Display for Memory {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Auto => write!(f, "auto"),
            Self::Megabytes(size) => write!(f, "{size}MB"),
            Self::Gigabytes(size) => write!(f, "{size}GB"),
        }
    }
}

impl FromStr for Memory {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        if text == "auto" {
            return Ok(Self::Auto);
        }
        let unknown = || format!("memory `{text}` is neither auto nor a size such as 500MB or 2GB");
        let in_megabytes = text.strip_suffix("MB");
        let number = in_megabytes.or_else(|| text.strip_suffix("GB")).ok_or_else(unknown)?;
        match number.trim().parse::<f64>() {
            Ok(size) if !size.is_finite() || size < 0.0 => {
                Err(format!("memory `{text}` is not a finite size of at least 0"))
            }
            Ok(size) if in_megabytes.is_some() => Ok(Self::Megabytes(size)),
            Ok(size) => Ok(Self::Gigabytes(size)),
            Err(_) => Err(unknown()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_written_is_read_back() {
        for (text, memory) in
            [("auto", Memory::Auto), ("500MB", Memory::Megabytes(500.0)), ("2.5GB", Memory::Gigabytes(2.5))]
        {
            assert_eq!((text.parse(), memory.to_string()), (Ok(memory), text.to_owned()));
        }
        assert_eq!((Memory::Megabytes(1.5).bytes(), Memory::Gigabytes(2.0).bytes()), (1_500_000, 2_000_000_000));
        assert!(Memory::Auto.bytes() > 1 << 20);
    }

    #[test]
    fn what_is_no_size_is_refused() {
        for text in ["", "2", "2TB", "GB", "manyMB", "-1GB", "infMB", "NaNGB"] {
            let error = text.parse::<Memory>().unwrap_err();
            assert!(error.contains(&format!("memory `{text}`")), "{error}");
        }
    }
}
