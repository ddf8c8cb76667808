//! How the colour of a primitive depends on the direction it is seen from.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use super::lobes::LOBE_LEN;

/// Value of the zeroth spherical harmonic.
pub const SH_C0: f64 = 0.282_094_791_773_878_14;

/// End of the name of a model whose opacities depend on the direction.
const AND_OPACITY: &str = "+opacity";

/// How colour depends on the viewing direction (DP-GES: spherical Beta with 2 lobes; 3DGS: harmonics of degree 3).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub enum ColourModel {
    /// Base colour plus `lobes` spherical Beta lobes of 6 raw numbers (r, g, b, θ, φ, β); 0 lobes is a constant colour.
    SphericalBeta { lobes: usize },
    /// Base colour plus spherical harmonics up to `degree` (0..=3), coefficient-major, 3 numbers per coefficient.
    SphericalHarmonics { degree: usize },
    /// The same colours, and opacities that depend on the direction as well: each has a factor of spherical harmonics up to
    /// `degree` (weighted sums).
    HarmonicsAndOpacity { degree: usize },
}

impl ColourModel {
    /// Numbers per primitive beside the base colour.
    pub const fn detail_len(self) -> usize {
        match self {
            Self::SphericalBeta { lobes } => LOBE_LEN * lobes,
            Self::SphericalHarmonics { degree } | Self::HarmonicsAndOpacity { degree } => {
                3 * ((degree + 1) * (degree + 1) - 1)
            }
        }
    }

    /// Numbers of a lobe, or of a coefficient of spherical harmonics.
    pub const fn detail_unit(self) -> usize {
        match self {
            Self::SphericalBeta { .. } => LOBE_LEN,
            Self::SphericalHarmonics { .. } | Self::HarmonicsAndOpacity { .. } => 3,
        }
    }

    /// Coefficients per primitive of the factor of its opacity; 0 where opacities are the same from everywhere.
    pub const fn opacity_len(self) -> usize {
        match self {
            Self::HarmonicsAndOpacity { degree } => (degree + 1) * (degree + 1),
            Self::SphericalBeta { .. } | Self::SphericalHarmonics { .. } => 0,
        }
    }

    /// The same with opacities that depend on the direction; lobes stay what they are.
    #[must_use]
    pub const fn with_opacity(self) -> Self {
        match self {
            Self::SphericalHarmonics { degree } => Self::HarmonicsAndOpacity { degree },
            other => other,
        }
    }

    /// The same with opacities that do not depend on the direction.
    #[must_use]
    pub const fn without_opacity(self) -> Self {
        match self {
            Self::HarmonicsAndOpacity { degree } => Self::SphericalHarmonics { degree },
            other => other,
        }
    }
}

impl fmt::Display for ColourModel {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::SphericalBeta { lobes } => write!(f, "sb{lobes}"),
            Self::SphericalHarmonics { degree } => write!(f, "sh{degree}"),
            Self::HarmonicsAndOpacity { degree } => write!(f, "sh{degree}{AND_OPACITY}"),
        }
    }
}

impl FromStr for ColourModel {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wrong = || format!("colour model `{text}` is unknown: use sb0, sb1, sb2, … (lobes) or sh0 to sh3 (degree)");
        let number = |digits: &str| digits.parse::<usize>().map_err(|_| wrong());
        if let Some(colours) = text.strip_suffix(AND_OPACITY) {
            let plain = colours.parse::<Self>().map_err(|_| wrong())?;
            return if plain.with_opacity() == plain { Err(wrong()) } else { Ok(plain.with_opacity()) };
        }
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn models_read_what_they_write() {
        for text in ["sb0", "sb2", "sh0", "sh3", "sh0+opacity", "sh3+opacity"] {
            assert_eq!(text.parse::<ColourModel>().unwrap().to_string(), text);
        }
        for text in ["", "sh4", "sb", "sb2+opacity", "sh3+", "+opacity", "sh3+opacity+opacity"] {
            assert!(text.parse::<ColourModel>().is_err(), "{text}");
        }
    }

    #[test]
    fn opacities_may_depend_on_the_direction_as_colours_do() {
        let plain: ColourModel = "sh2".parse().unwrap();
        let both = plain.with_opacity();
        assert_eq!((both.opacity_len(), both.detail_len()), (9, plain.detail_len()));
        assert_eq!((plain.opacity_len(), both.without_opacity(), both.with_opacity()), (0, plain, both));
        let lobes = ColourModel::default();
        assert_eq!((lobes.with_opacity(), lobes.without_opacity(), lobes.opacity_len()), (lobes, lobes, 0));
    }
}
