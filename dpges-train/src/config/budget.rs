//! How large a scene may grow.

use std::fmt;
use std::str::FromStr;

use dpges_core::scene::ColourModel;
use serde::{Deserialize, Serialize};

use super::declare::value;

/// Bytes.
pub const MEGABYTE: f64 = 1e6;

/// Largest number of surfels and Gaussians together, or largest size of the scene file. `0` reads as `pixels`. In TOML
/// a number of primitives is a whole number, anything else a string.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "Written", into = "Written")]
pub enum Budget {
    /// One primitive per two different pixels of the training views.
    Pixels,
    /// As many as improve the pictures of training views, or of validation views where some are kept.
    Auto,
    /// At least 1.
    Primitives(usize),
    /// In units of 10⁶ bytes; positive and finite.
    Megabytes(f64),
}

value!(
    Budget, "a whole number or a string", |value| value.is_integer() || value.is_str(),
    "pixels" => "One primitive per two different pixels of the training views, at least 16,384; views that share what they show count once.",
    "auto" => "As many as improve the pictures of training views (of validation views if `data.validation_every` keeps some), at most four times `pixels`.",
    "N" => "N surfels and Gaussians together.",
    "NMB" => "As many as a scene file of N million bytes holds with all lobes, not counting its header."
);

/// A budget as TOML and JSON contain it.
#[derive(Serialize, Deserialize)]
#[serde(untagged, expecting = "expected pixels, auto, a whole number of primitives or a size such as 12.5MB")]
enum Written {
    Whole(i64),
    Text(String),
}

fn unknown(text: &str) -> String {
    format!("budget `{text}` is neither pixels, auto, a whole number of primitives nor a size such as 12.5MB")
}

impl fmt::Display for Budget {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Pixels => write!(f, "pixels"),
            Self::Auto => write!(f, "auto"),
            Self::Primitives(count) => write!(f, "{count}"),
            Self::Megabytes(size) => write!(f, "{size}MB"),
        }
    }
}

impl FromStr for Budget {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        if let Some(size) = text.strip_suffix("MB") {
            return match size.trim().parse::<f64>() {
                Ok(size) if size.is_finite() && size > 0.0 => Ok(Self::Megabytes(size)),
                Ok(_) => Err(format!("budget `{text}` is not a positive, finite number of MB")),
                Err(_) => Err(unknown(text)),
            };
        }
        match text {
            "pixels" => Ok(Self::Pixels),
            "auto" => Ok(Self::Auto),
            _ => match text.parse::<usize>() {
                Ok(0) => Ok(Self::Pixels),
                Ok(count) => Ok(Self::Primitives(count)),
                Err(_) => Err(unknown(text)),
            },
        }
    }
}

impl TryFrom<Written> for Budget {
    type Error = String;

    fn try_from(written: Written) -> Result<Self, String> {
        match written {
            Written::Whole(number) => number.to_string().parse(),
            Written::Text(text) => text.parse(),
        }
    }
}

impl From<Budget> for Written {
    fn from(budget: Budget) -> Self {
        match budget {
            Budget::Primitives(count) => {
                i64::try_from(count).map_or_else(|_| Self::Text(count.to_string()), Self::Whole)
            }
            other => Self::Text(other.to_string()),
        }
    }
}

/// Bytes of a surfel and of a Gaussian in a scene file, with all lobes of `model`.
pub fn bytes_per_primitive(model: ColourModel) -> [usize; 2] {
    let base = 3;
    let [surfel, gaussian] = [3 + 4 + 2 + base + 1, 3 + 4 + 3 + base + 1];
    let lobe_count = match model {
        ColourModel::SphericalBeta { .. } => 1,
        ColourModel::SphericalHarmonics { .. } | ColourModel::HarmonicsAndOpacity { .. } => 0,
    };
    let gaussian = gaussian + model.opacity_len();
    [surfel, gaussian].map(|numbers| size_of::<f32>() * (numbers + model.detail_len()) + lobe_count)
}

/// Number of primitives that a scene file of `bytes` holds, not counting its header, with all lobes of `model`.
/// `surfel_share`, from 0 to 1, is the share of surfels among them.
pub fn primitives_for(bytes: f64, model: ColourModel, surfel_share: f64) -> usize {
    let [surfel, gaussian] = bytes_per_primitive(model).map(|bytes| bytes as f64);
    (bytes / (surfel_share * surfel + (1.0 - surfel_share) * gaussian)) as usize
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Config;

    #[derive(Debug, PartialEq, Serialize, Deserialize)]
    struct Section {
        budget: Budget,
    }

    fn from_toml(value: &str) -> Result<Budget, String> {
        toml::from_str::<Section>(&format!("budget = {value}")).map(|s| s.budget).map_err(|error| error.to_string())
    }

    #[test]
    fn an_automatic_budget_alone_keeps_no_views() {
        let every = |set: &str| Config::with(&[set]).unwrap().validation_every();
        assert_eq!(["refine.budget=auto", "train.stop=validation", "data.validation_every=4"].map(every), [0, 8, 4]);
    }

    #[test]
    fn what_is_written_is_read_back() {
        for (text, budget) in [
            ("pixels", Budget::Pixels),
            ("auto", Budget::Auto),
            ("50000", Budget::Primitives(50_000)),
            ("12.5MB", Budget::Megabytes(12.5)),
            ("12MB", Budget::Megabytes(12.0)),
        ] {
            assert_eq!(text.parse::<Budget>(), Ok(budget));
            assert_eq!(budget.to_string(), text);
            let section = Section { budget };
            assert_eq!(toml::from_str::<Section>(&toml::to_string(&section).unwrap()).unwrap(), section);
            assert_eq!(serde_json::from_str::<Section>(&serde_json::to_string(&section).unwrap()).unwrap(), section);
        }
        assert_eq!("0".parse::<Budget>(), Ok(Budget::Pixels));
        assert_eq!("7.25 MB".parse::<Budget>(), Ok(Budget::Megabytes(7.25)));
        let most = Section { budget: Budget::Primitives(usize::MAX) };
        assert_eq!(toml::from_str::<Section>(&toml::to_string(&most).unwrap()).unwrap(), most);
    }

    #[test]
    fn toml_takes_whole_numbers_and_strings() {
        assert_eq!(from_toml("50000"), Ok(Budget::Primitives(50_000)));
        assert_eq!(from_toml("\"50000\""), Ok(Budget::Primitives(50_000)));
        assert_eq!(from_toml("0"), Ok(Budget::Pixels));
        assert_eq!(from_toml("\"auto\""), Ok(Budget::Auto));
        assert_eq!(from_toml("\"12MB\""), Ok(Budget::Megabytes(12.0)));
        let written = |budget| toml::to_string(&Section { budget }).unwrap();
        assert_eq!(written(Budget::Primitives(50_000)).trim(), "budget = 50000");
        assert_eq!(written(Budget::Pixels).trim(), "budget = \"pixels\"");
    }

    #[test]
    fn what_is_not_a_budget_is_refused() {
        for text in ["", "many", "-1", "1.5", "MB", "12GB", "12mb", "1,5MB", "1e5"] {
            let error = text.parse::<Budget>().unwrap_err();
            assert!(error.contains(&format!("`{text}` is neither pixels, auto")), "{error}");
        }
        for text in ["0MB", "-3MB", "infMB", "NaNMB"] {
            let error = text.parse::<Budget>().unwrap_err();
            assert!(error.contains(text) && error.contains("positive, finite number of MB"), "{error}");
        }
        for value in ["-1", "1.5", "\"12GB\"", "true", "[1]"] {
            let error = from_toml(value).unwrap_err();
            assert!(error.contains("a whole number of primitives") && error.contains("12.5MB"), "{error}");
        }
    }

    #[test]
    fn bytes_are_those_of_the_scene_file() {
        // surfel: position 3, rotation 4, scales 2, base colour 3, margin 1; Gaussian: scales 3, opacity 1, no margin
        assert_eq!(bytes_per_primitive(ColourModel::SphericalBeta { lobes: 0 }), [53, 57]);
        assert_eq!(bytes_per_primitive(ColourModel::SphericalBeta { lobes: 2 }), [101, 105]);
        assert_eq!(bytes_per_primitive(ColourModel::SphericalHarmonics { degree: 3 }), [232, 236]);
        assert_eq!(bytes_per_primitive(ColourModel::HarmonicsAndOpacity { degree: 3 }), [232, 300]);
        let two = ColourModel::SphericalBeta { lobes: 2 };
        assert_eq!(primitives_for(12.5 * MEGABYTE, two, 0.0), 119_047);
        assert_eq!(primitives_for(12.5 * MEGABYTE, two, 1.0), 123_762);
        assert_eq!(primitives_for(2.0 * 103.0 * 1000.0, two, 0.5), 2000);
        assert_eq!(primitives_for(100.0, two, 0.5), 0);
    }
}
