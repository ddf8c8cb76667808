//! How far a scene is compressed.

use std::fmt;
use std::str::FromStr;

use clap::ValueEnum;
use dpges_core::scene::Quality;
use dpges_train::config::budget::MEGABYTE;

/// Levels of quality.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Level {
    /// 16 bits per number: nearly without loss
    Highest,
    /// 9 bits: for views from closer than the photographs
    High,
    /// 7 bits
    Medium,
    /// 5 to 6 bits: where size matters most
    Low,
}

impl Level {
    pub fn quality(self) -> Quality {
        match self {
            Self::Highest => Quality::HIGHEST,
            Self::High => Quality::HIGH,
            Self::Medium => Quality::MEDIUM,
            Self::Low => Quality::LOW,
        }
    }
}

/// What a compressed scene has to keep to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Target {
    /// Largest size of the file, bytes.
    Bytes(usize),
    /// Largest loss of PSNR, dB.
    Loss(f64),
}

impl FromStr for Target {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wrong = || format!("`{text}` is neither a size such as 10MB nor a loss such as 0.1dB");
        let number = |digits: &str| {
            let number = digits.trim().parse::<f64>().ok().filter(|number| number.is_finite() && *number > 0.0);
            number.ok_or_else(wrong)
        };
        match (text.strip_suffix("MB"), text.strip_suffix("dB")) {
            (Some(size), _) => Ok(Self::Bytes((number(size)? * MEGABYTE).round() as usize)),
            (_, Some(loss)) => Ok(Self::Loss(number(loss)?)),
            _ => Err(wrong()),
        }
    }
}

impl fmt::Display for Target {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Bytes(bytes) => write!(f, "{}MB", *bytes as f64 / MEGABYTE),
            Self::Loss(loss) => write!(f, "{loss}dB"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn targets_are_sizes_or_losses() {
        for (text, target) in [
            ("10MB", Target::Bytes(10_000_000)),
            ("0.25MB", Target::Bytes(250_000)),
            ("0.1dB", Target::Loss(0.1)),
            ("2dB", Target::Loss(2.0)),
        ] {
            assert_eq!(text.parse(), Ok(target));
            assert_eq!(target.to_string(), text);
        }
        for wrong in ["10", "MB", "0MB", "-1dB", "nandB", "infMB", "10 bytes", ""] {
            assert!(wrong.parse::<Target>().unwrap_err().contains("such as 10MB"), "{wrong}");
        }
    }

    #[test]
    fn every_level_is_one_of_the_library() {
        let names =
            Level::value_variants().iter().map(|level| level.to_possible_value().unwrap().get_name().to_owned());
        let levels: Vec<(String, Quality)> =
            names.zip(Level::value_variants().iter().map(|level| level.quality())).collect();
        assert_eq!(levels, Quality::LEVELS.map(|(name, quality)| (name.to_owned(), quality)));
    }
}
