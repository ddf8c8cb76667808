//! How surfels of a scene become layers.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

/// Where a surfel ends.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Footprint {
    /// Where the kernel G falls below 1/255: 3.33 σ.
    #[default]
    Kernel,
    /// Where the opacity w G falls below 1/255: 4.23 σ at w = 30.
    Opacity,
}

impl Footprint {
    /// Squared distance from its centre, in σ², at which a surfel of modulation w ends; below 0 if no part of it is visible.
    pub fn squared_radius(self, modulation: f64) -> f64 {
        match self {
            Self::Kernel => 2.0 * 255f64.ln(),
            Self::Opacity => 2.0 * (255.0 * modulation).ln(),
        }
    }

    /// How much opacity falls per σ² in the rim with [`Peeling::Continuous`]: from 1 where w G = 1 to 0 at the end. A surfel
    /// without a rim ends with a step.
    pub fn rim_slope(self, modulation: f64) -> f64 {
        let rim = self.squared_radius(modulation) - 2.0 * modulation.ln();
        1.0 / rim.max(1.0 / STEP)
    }
}

/// How the fragments of surfels at a pixel become layers, and which Gaussians lie before a layer.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Peeling {
    /// Nothing jumps when the camera moves: opacity falls to 0 at the end of a rim, the nearest opaque fragment is a layer
    /// however many rims lie before it, fragments at nearly the same depth mix, and Gaussians fade where they pass a layer.
    #[default]
    Continuous,
    /// The K nearest fragments in the order of their depths, opaque or not. A Gaussian within the margin of a layer counts as
    /// before it (DP-GES).
    Nearest,
    /// The same, but a Gaussian behind the bare depth of a layer counts as behind it, as the paper prints it: behind an
    /// opaque layer nothing has weight, margin or not.
    Literal,
}

/// Slope of a step: finite, so that 0 times it is 0, and more than the inverse of any difference of depths.
pub const STEP: f64 = 1e30;
/// Depth within which two surfels have no certain order with [`Peeling::Continuous`], in margins of the finer one: the
/// share of one that lies behind the other rises from 0 to 1 over twice this depth.
pub const ORDER: f64 = 0.1;
/// Depth over which a Gaussian fades behind a layer with [`Peeling::Continuous`], in margins of the pixel.
pub const RAMP: f64 = 0.2;

impl Peeling {
    pub const fn is_continuous(self) -> bool {
        matches!(self, Self::Continuous)
    }

    /// The peeling of a scene whose `info` does not name it. Such files say whether the nearest opaque fragment is always a
    /// layer, in strict order, which is now [`Continuous`](Self::Continuous), and which depths are compared.
    pub(super) fn of_older_file(info: &Map<String, Value>) -> Self {
        let has = |name: &str, value: Value| info.get(name) == Some(&value);
        if has("backstop", true.into()) {
            Self::Continuous
        } else if has("margin_lookup", "literal".into()) {
            Self::Literal
        } else {
            Self::Nearest
        }
    }
}

impl fmt::Display for Peeling {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.serialize(f)
    }
}

impl FromStr for Peeling {
    type Err = serde_json::Error;

    fn from_str(name: &str) -> Result<Self, Self::Err> {
        serde_json::from_value(name.into())
    }
}
