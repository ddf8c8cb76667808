//! How the colour of a primitive depends on the direction it is seen from.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

/// Value of the zeroth spherical harmonic.
pub const SH_C0: f64 = 0.282_094_791_773_878_14;

/// How colour depends on the viewing direction (DP-GES: spherical Beta with 2 lobes; 3DGS: harmonics of degree 3).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub enum ColourModel {
    /// Base colour plus `lobes` spherical Beta lobes of 6 raw numbers (r, g, b, θ, φ, β); 0 lobes is a constant colour.
    SphericalBeta { lobes: usize },
    /// Base colour plus spherical harmonics up to `degree` (0..=3), coefficient-major, 3 numbers per coefficient.
    SphericalHarmonics { degree: usize },
}

impl ColourModel {
    /// Numbers per primitive beside the base colour.
    pub const fn detail_len(self) -> usize {
        match self {
            Self::SphericalBeta { lobes } => 6 * lobes,
            Self::SphericalHarmonics { degree } => 3 * ((degree + 1) * (degree + 1) - 1),
        }
    }
}

impl fmt::Display for ColourModel {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::SphericalBeta { lobes } => write!(f, "sb{lobes}"),
            Self::SphericalHarmonics { degree } => write!(f, "sh{degree}"),
        }
    }
}

impl FromStr for ColourModel {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wrong = || format!("colour model `{text}` is unknown: use sb0, sb1, sb2, … (lobes) or sh0 to sh3 (degree)");
        let number = |digits: &str| digits.parse::<usize>().map_err(|_| wrong());
        match text.get(..2) {
            Some("sb") => Ok(Self::SphericalBeta { lobes: number(&text[2..])? }),
            Some("sh") => match number(&text[2..])? {
                degree @ 0..=3 => Ok(Self::SphericalHarmonics { degree }),
                _ => Err(wrong()),
            },
            _ => Err(wrong()),
        }
    }
}

impl TryFrom<String> for ColourModel {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        text.parse()
    }
}

impl From<ColourModel> for String {
    fn from(model: ColourModel) -> Self {
        model.to_string()
    }
}

/// A constant colour.
impl Default for ColourModel {
    fn default() -> Self {
        Self::SphericalBeta { lobes: 0 }
    }
}
