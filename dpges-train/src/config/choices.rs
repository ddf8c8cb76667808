//! Values of keys that are neither numbers nor paths.

use std::fmt;
use std::str::FromStr;

use dpges_render::Up;
use serde::{Deserialize, Serialize};

use super::declare::{choices, text, value};

choices! {
    /// The method that a run trains.
    Method {
        /// Surfels and Gaussians together, after the stages of `[stages]` (DP-GES).
        "dpges" => Dpges,
        /// Discs alone: flat Gaussians, sorted by depth and blended (2DGS).
        "2dgs" => Discs,
        /// Gaussians alone, sorted and blended, relocated at intervals and jittered at every step (3DGS-MCMC).
        "mcmc" => Mcmc,
        /// Gaussians alone, sorted and blended, jittered only when they are relocated (DBS with a Gaussian kernel).
        "dbs" => Dbs,
        /// Gaussians alone, sorted and blended, cloned, split and removed by their gradients and opacities, with spherical
        /// harmonics and the rates of its paper (3DGS).
        "3dgs" => Gaussians3d,
        /// The same, splitting by the sums of absolute gradients (AbsGS).
        "absgs" => Absolute,
        /// 3DGS whose Gaussians are sorted for each pixel along its ray, so that none pops in front of another when the
        /// camera turns (StopThePop).
        "stopthepop" => StopThePop,
        /// 3DGS with Gaussians no finer than what the training views resolve, and a filter that keeps their weight on the
        /// screen (Mip-Splatting).
        "mip-splatting" => MipSplatting,
        /// Gaussians that rays meet without a projection, the nearest of each pixel blended in order and the others mixed
        /// behind them, no finer than what the training views resolve (HTGS).
        "htgs" => Htgs,
        /// Kernels of Student's t distribution alone, some of which take colour away, sorted and blended, relocated at
        /// intervals, with positions by stochastic gradient Hamiltonian Monte Carlo, spherical harmonics and the rates of
        /// its paper (SSS).
        "sss" => Sss,
        /// Gaussians alone, summed in any order with weights by their depths, under the densification of 3DGS, which removes
        /// none of them (Sort-free Gaussian Splatting via Weighted Sum Rendering).
        "sortfree" => SortFree,
    }

    /// Where the Gaussians of the joint stage come from.
    GaussianStage {
        /// A stage of DBS (DP-GES).
        "dbs" => Dbs,
        /// A stage of 3DGS-MCMC.
        "mcmc" => Mcmc,
        /// The discs that are not opaque enough to become surfels (GES).
        "rest" => Rest,
    }

    /// Meaning of the alpha of pictures.
    Alpha {
        /// How much of a photograph covers the background: it is composited on `data.background`.
        "matte" => Matte,
        /// Which pixels count: those of at least half alpha, with the colour that they have.
        "mask" => Mask,
    }

    /// The end of a run.
    Stop {
        /// Its length, `train.steps`.
        "steps" => Steps,
        /// Validation views that no longer improve, or its length. The result is the best scene, not the last.
        "validation" => Validation,
    }

    /// Depth maps beside the photographs.
    DepthMaps {
        /// There are none, or they are not read.
        "none" => None,
        /// Depths: camera-space z, or distances from the camera's centre for photographs through a fisheye lens. A step of
        /// their values is `depth_unit_scale_factor` world units, 0.001 if the dataset does not say.
        "metric" => Metric,
        /// Disparities, larger where what they show is nearer, with a scale and a shift that differ from map to map: what
        /// networks make of single photographs.
        "relative" => Relative,
    }

    /// Whether every training view has a colour correction of its own.
    Exposure {
        /// Photographs are taken as they are.
        "off" => Off,
        /// Each has a gain and an offset per channel, which are learnt.
        "on" => On,
        /// On if the points of the dataset are differently bright in different photographs: by a standard deviation of
        /// more than 0.1 stops of display-referred values.
        "auto" => Auto,
    }

    /// Whether the poses of training views are refined.
    Poses {
        /// Cameras stand and look as the dataset says.
        "off" => Off,
        /// Each has a small rotation and translation, which are learnt.
        "on" => On,
        /// On if the points of the dataset are not where photographs show them, as COLMAP's keypoints say: by more than 1 px of
        /// the photographs as they are trained on, in the median. Off where that is not known.
        "auto" => Auto,
    }

    /// Kind of new Gaussians of the joint stage.
    NewGaussians {
        /// Copies of those that answer for the most error, which share their opacity: no picture changes.
        "copies" => Copies,
        /// Black ones over surfels, at pixels drawn in proportion to their squared error (GES, DP-GES).
        "black" => Black,
    }

    /// Where surfels start if no discs were trained.
    SurfelStart {
        /// On the surfaces that trained Gaussians show to several views; as `[init]` says if none were trained.
        "depth" => Depth,
        /// As `[init]` says.
        "points" => Points,
    }

    /// Opacity in the joint stage of a Gaussian that was blended before.
    JointOpacity {
        /// α / (1 − α), the weight that gives it the same share of a pixel before a surfel.
        "odds" => Odds,
        /// α, as it was (GES, DP-GES).
        "kept" => Kept,
    }

    /// Which scales the depth margin of a surfel is computed from.
    Margin {
        /// The median over the 16 nearest surfels (DP-GES).
        "median" => Median,
        /// Its own (GES).
        "raw" => Raw,
    }

    /// Colour behind all surfels and Gaussians, in the direction of a pixel.
    Environment {
        /// Spherical harmonics of degree 3 if more than 5 % of the training pixels are open sky: above the horizon, with
        /// no point of the dataset from there up to the border of the picture; or if there are no points. The background
        /// alone otherwise, and if `data.background` is set or pictures have alpha.
        "auto" => Auto,
        /// The background alone.
        "none" => None,
        /// The background and a colour that is learnt.
        "sh0" => Degree0,
        /// The background and spherical harmonics of degree 1 to 3.
        "sh1" => Degree1,
        /// Likewise.
        "sh2" => Degree2,
        /// Likewise.
        "sh3" => Degree3,
    }

    /// Where surfels and Gaussians start.
    InitMethod {
        /// The first of the following that the dataset allows.
        "auto" => Auto,
        /// On the points of structure from motion; if they are fewer than 3,000, also where views agree about a colour.
        "sfm" => Sfm,
        /// In the visual hull of pictures with alpha, where views agree about a colour.
        "silhouette" => Silhouette,
        /// Where views agree about a colour, in view of the cameras.
        "plane-sweep" => PlaneSweep,
        /// Gaussians at random places in view of the cameras; no surfels.
        "random" => Random,
    }
}

impl Environment {
    /// The degree that is asked for; `None` without an environment, and where the dataset decides.
    pub fn degree(self) -> Option<usize> {
        match self {
            Self::Auto | Self::None => None,
            Self::Degree0 => Some(0),
            Self::Degree1 => Some(1),
            Self::Degree2 => Some(2),
            Self::Degree3 => Some(3),
        }
    }
}

/// Colour behind the scene.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub enum Background {
    /// White for datasets in the Blender layout, black otherwise.
    Auto,
    /// Display-referred red, green and blue, 0 to 1.
    Colour([f64; 3]),
    /// None, for pictures of `dpges render`.
    Transparent,
}

value!(
    Background, "a string", toml::Value::is_str,
    "auto" => "White for datasets in the Blender layout, black otherwise.",
    "black" => "",
    "white" => "",
    "r,g,b" => "Display-referred red, green and blue, 0 to 1.",
    "transparent" => "None: pictures of `dpges render` have alpha. For nothing else."
);
text!(Background);

/// What is up in a scene.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub enum Upwards {
    /// As the training cameras are held.
    Auto,
    Along(Up),
}

value!(
    Upwards, "a string", toml::Value::is_str,
    "auto" => "As the training cameras are held.",
    "x, y, z, -x, -y, -z" => "This axis of the dataset.",
    "a,b,c" => "A direction in the dataset, such as `0,-1,0.2`."
);
text!(Upwards);

impl fmt::Display for Upwards {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Auto => write!(f, "auto"),
            Self::Along(up) => up.fmt(f),
        }
    }
}

impl FromStr for Upwards {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        if text == "auto" { Ok(Self::Auto) } else { text.parse().map(Self::Along) }
    }
}

impl fmt::Display for Background {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Auto => write!(f, "auto"),
            Self::Colour([0.0, 0.0, 0.0]) => write!(f, "black"),
            Self::Colour([1.0, 1.0, 1.0]) => write!(f, "white"),
            Self::Colour([r, g, b]) => write!(f, "{r},{g},{b}"),
            Self::Transparent => write!(f, "transparent"),
        }
    }
}

impl FromStr for Background {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "auto" => return Ok(Self::Auto),
            "black" => return Ok(Self::Colour([0.0; 3])),
            "white" => return Ok(Self::Colour([1.0; 3])),
            "transparent" => return Ok(Self::Transparent),
            _ => {}
        }
        let parts: Option<Vec<f64>> = text.split(',').map(|part| part.trim().parse().ok()).collect();
        match parts.as_deref() {
            Some(&[r, g, b]) if [r, g, b].iter().all(|c| (0.0..=1.0).contains(c)) => Ok(Self::Colour([r, g, b])),
            _ => Err(format!(
                "background `{text}` is neither auto, black, white, transparent nor three numbers from 0 to 1"
            )),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn backgrounds_read_what_they_write() {
        for text in ["auto", "black", "white", "0.25,0.5,1", "transparent"] {
            assert_eq!(text.parse::<Background>().unwrap().to_string(), text);
        }
        for text in ["", "red", "1,1", "1,1,2", "0,0,nan"] {
            assert!(text.parse::<Background>().unwrap_err().contains(text));
        }
    }
}
