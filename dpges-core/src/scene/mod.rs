//! A scene: surfels, Gaussians, and what is needed to render them. [`schema`] declares their attributes; [`data`] holds
//! them in host memory, [`tensors`] on a device, [`mod@file`] on disk, [`compressed`] in fewer bytes, [`lod`] in levels of
//! detail.

pub mod atomic;
mod colour_model;
pub mod compressed;
pub mod container;
pub mod data;
mod environment;
pub mod file;
pub mod length;
pub mod lobes;
pub mod lod;
pub mod peeling;
pub mod schema;
#[cfg(feature = "burn")]
pub mod split;
mod stored_size;
#[cfg(feature = "burn")]
pub mod tensors;
mod weighted_sum;

use std::fmt;

use serde::{Deserialize, Serialize};

pub use colour_model::{ColourModel, SH_C0};
pub use compressed::{Quality, along_morton_curve};
pub use data::{ColourData, GaussianData, SceneData, SurfelData};
pub use environment::EnvironmentData;
pub use peeling::{Footprint, Peeling};
pub use schema::OpacityActivation;
#[cfg(feature = "burn")]
pub use tensors::{Colour, Gaussians, Surfels};
pub use weighted_sum::{DepthWeight, WeightedSum};

/// The low-pass filter of the projected covariance of a Gaussian.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ScreenFilter {
    /// 0.1 px²; opacities are dimmed so that the weight over the picture stays (GES, Mip-Splatting).
    #[default]
    Compensated,
    /// 0.3 px² (3DGS): Gaussians finer than a pixel become brighter from farther away.
    Plain,
    /// None (SSS): Gaussians finer than a pixel vanish between the centres of pixels.
    Off,
}

impl ScreenFilter {
    /// The variance added to the diagonal of the covariance, px².
    pub const fn variance(self) -> f64 {
        match self {
            Self::Compensated => 0.1,
            Self::Plain => 0.3,
            Self::Off => 0.0,
        }
    }
}

/// Largest α of a fragment that is blended: backward divides by 1 − α.
pub const HIGHEST_ALPHA: f64 = 0.9999;

/// The order in which the fragments of a pixel are blended.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum BlendOrder {
    /// One order for all pixels: by the depth of the centre, then by index (3DGS).
    #[default]
    Centres,
    /// An order for each pixel: by the depth at which its ray meets the most of a Gaussian, as far as queues of limited
    /// length sort it (StopThePop).
    Rays,
    /// That of Gaussians which rays meet as they are, without a projection (HTGS).
    #[serde(untagged)]
    Whitened(Transparency),
}

impl BlendOrder {
    pub const fn transparency(self) -> Option<Transparency> {
        if let Self::Whitened(transparency) = self { Some(transparency) } else { None }
    }
}

impl fmt::Display for BlendOrder {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.serialize(f)
    }
}

/// Which fragments of a pixel have an order (HTGS).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Transparency {
    /// The nearest along the ray of those that are not faint. The others are mixed behind them.
    #[default]
    Hybrid,
    /// The same nearest. There are no others.
    Nearest,
    /// All, in one order for all pixels: by the depth of the centre, then by index.
    Sorted,
    /// None: all are mixed.
    Tail,
}

impl fmt::Display for Transparency {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.serialize(f)
    }
}

/// How a scene becomes a picture.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Rendering {
    /// Surfels are peeled, and Gaussians splatted between their layers (DP-GES).
    #[default]
    Peeled,
    /// Gaussians are blended in the order of their depths; there are no surfels (3DGS).
    Ellipsoids,
    /// Gaussians are flat: the discs of their first two axes are blended in the order of their depths (2DGS).
    Discs,
    /// Ellipsoids with kernels of Student's t distribution, whose opacities may be below 0, are blended in the order of
    /// their depths (SSS).
    Students,
    /// Gaussians are summed in any order, weighted by their depths, and divided by the sum of the weights; there are no
    /// surfels (see [`WeightedSum`]).
    Summed,
}

impl fmt::Display for Rendering {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.serialize(f)
    }
}

/// The content of a scene file besides its tensors.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SceneInfo {
    pub colour_model: ColourModel,
    /// w of the paper: opacity of a surfel is min(1, w G).
    pub modulation: f64,
    /// K: peeled layers.
    pub layer_count: usize,
    pub footprint: Footprint,
    /// Older files tell it by other entries.
    pub peeling: Peeling,
    pub rendering: Rendering,
    /// Filter of blended Gaussians; of everything that is peeled [`ScreenFilter::Compensated`].
    pub screen_filter: ScreenFilter,
    pub blend_order: BlendOrder,
    /// The numbers of [`Rendering::Summed`]; no other scene has them.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub weighted_sum: Option<WeightedSum>,
    /// Display-referred colour behind everything; an [environment](EnvironmentData) adds to it.
    pub background: [f64; 3],
    /// World units: subtract from the dataset's coordinates to get the scene's.
    pub offset: [f64; 3],
    /// Unit vector upwards. `None` if nobody knows, as in files before version 3: then it is taken to be −y.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub up: Option<[f64; 3]>,
    /// E: 1.1 × the largest distance of a training camera from their mean, world units.
    pub extent: f64,
    /// World units; cameras made for this scene use it.
    pub near: f64,
    /// Metres per world unit, where someone has measured a length. `None` if nobody has, as in all older files.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub metres_per_unit: Option<f64>,
}

impl SceneInfo {
    /// The largest α of a fragment of blended Gaussians: that of the method which trains them (3DGS, 2DGS, SSS: 0.99, DBS:
    /// 0.999), or the largest there is (HTGS).
    pub fn max_alpha(&self) -> f64 {
        if self.blend_order.transparency().is_some() {
            return HIGHEST_ALPHA;
        }
        let as_published = matches!(self.rendering, Rendering::Discs | Rendering::Students)
            || self.screen_filter == ScreenFilter::Plain;
        if as_published { 0.99 } else { 0.999 }
    }

    /// That of the same scene in coordinates which are `factor` times as large.
    #[must_use]
    pub fn scaled(&self, factor: f64) -> Self {
        Self {
            offset: self.offset.map(|x| factor * x),
            extent: factor * self.extent,
            near: factor * self.near,
            metres_per_unit: self.metres_per_unit.map(|metres| metres / factor),
            ..self.clone()
        }
    }
}

impl Default for SceneInfo {
    /// The default model in a bounded scene around the origin.
    fn default() -> Self {
        Self {
            colour_model: ColourModel::SphericalBeta { lobes: 2 },
            modulation: 30.0,
            layer_count: 5,
            footprint: Footprint::default(),
            peeling: Peeling::default(),
            rendering: Rendering::default(),
            screen_filter: ScreenFilter::default(),
            blend_order: BlendOrder::default(),
            weighted_sum: None,
            background: [0.0; 3],
            offset: [0.0; 3],
            up: None,
            extent: 1.0,
            near: 0.01,
            metres_per_unit: None,
        }
    }
}
