//! Options of drawing.

use std::fmt;

use dpges_core::Error;
use dpges_core::scene::{Footprint, Peeling, SceneInfo};

/// Largest number of layers that are peeled.
pub const MAX_LAYERS: usize = 5;

/// Bits per channel of the sums of Gaussians.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Precision {
    /// 32: needs [`wgpu::Features::FLOAT32_BLENDABLE`].
    Float,
    /// 16: every device can.
    Half,
}

/// Where the depths of surfels come from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DepthSource {
    /// The rasteriser interpolates them between corners. Hidden fragments need not be shaded.
    Rasterised,
    /// Every fragment computes its own, to full precision: for drivers that move corners to coarse steps, and for OpenGL,
    /// which rounds depths far away.
    Computed,
}

/// The content of a picture.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Display {
    #[default]
    Image,
    /// The surfels alone, on the background.
    Surfels,
    /// The contribution of the Gaussians: C_G / (1 + W_G).
    Gaussians,
    /// T_1: white where all light passes the first layer.
    Transmittance,
    /// Depth of the first layer, dark: near. The colours span most of the scene's depths.
    Depth,
    /// World x, y, z of the first layer's normal as red, green, blue.
    Normal,
    /// How many layers a pixel has, of K.
    LayerCount,
    /// How many fragments are shaded per pixel, of surfels (once, not per layer) and Gaussians; yellow: 64 or more.
    Overdraw,
}

impl Display {
    pub const ALL: [Self; 8] = [
        Self::Image,
        Self::Surfels,
        Self::Gaussians,
        Self::Transmittance,
        Self::Depth,
        Self::Normal,
        Self::LayerCount,
        Self::Overdraw,
    ];
}

impl fmt::Display for Display {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Image => "image",
            Self::Surfels => "surfels",
            Self::Gaussians => "Gaussians",
            Self::Transmittance => "transmittance",
            Self::Depth => "depth",
            Self::Normal => "normals",
            Self::LayerCount => "layer count",
            Self::Overdraw => "overdraw",
        })
    }
}

/// How a scene is drawn. [`From<&SceneInfo>`] gives what the scene was trained with.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RenderOptions {
    /// K, 1 to [`MAX_LAYERS`].
    pub layer_count: usize,
    /// w: opacity of a surfel is min(1, w G).
    pub modulation: f64,
    pub footprint: Footprint,
    pub peeling: Peeling,
    /// C_b, display-referred.
    pub background: [f64; 3],
    pub display: Display,
    /// Primitives whose radius on screen is smaller than this are not drawn, px. 0 draws all.
    pub smallest_px: f64,
}

impl From<&SceneInfo> for RenderOptions {
    /// At most [`MAX_LAYERS`] layers.
    fn from(info: &SceneInfo) -> Self {
        Self {
            layer_count: info.layer_count.min(MAX_LAYERS),
            modulation: info.modulation,
            footprint: info.footprint,
            peeling: info.peeling,
            background: info.background,
            display: Display::Image,
            smallest_px: 0.0,
        }
    }
}

impl RenderOptions {
    /// Layers that are peeled one by one; a core has a pass of its own.
    pub(crate) fn peels(&self) -> usize {
        self.layer_count - usize::from(self.peeling.is_continuous())
    }

    /// # Errors
    /// [`Error::Option`] for a number outside its range.
    pub fn validate(&self) -> Result<(), Error> {
        let check = |option, ok: bool, found: String, expected: &str| {
            if ok { Ok(()) } else { Err(Error::Option { option, expected: expected.to_owned(), found }) }
        };
        let (layers, w, smallest) = (self.layer_count, self.modulation, self.smallest_px);
        check("layer_count", (1..=MAX_LAYERS).contains(&layers), layers.to_string(), "1 to 5")?;
        check("modulation", w.is_finite() && w > 0.0, w.to_string(), "a positive, finite number")?;
        let background = format!("{:?}", self.background);
        check("background", self.background.iter().all(|c| c.is_finite()), background, "finite numbers")?;
        check("smallest_px", smallest.is_finite() && smallest >= 0.0, smallest.to_string(), "a number of at least 0")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn options_of_a_scene_are_valid_and_wrong_ones_are_named() {
        let good =
            RenderOptions::from(&SceneInfo { layer_count: 8, peeling: Peeling::Literal, ..SceneInfo::default() });
        assert_eq!((good.layer_count, good.peeling), (MAX_LAYERS, Peeling::Literal));
        good.validate().unwrap();
        let name = |options: RenderOptions| options.validate().unwrap_err().to_string();
        assert!(name(RenderOptions { layer_count: 0, ..good }).contains("`layer_count` is 0"));
        assert!(name(RenderOptions { layer_count: 6, ..good }).contains("`layer_count` is 6"));
        assert!(name(RenderOptions { modulation: f64::NAN, ..good }).contains("`modulation`"));
        assert!(name(RenderOptions { smallest_px: -1.0, ..good }).contains("`smallest_px`"));
        assert!(name(RenderOptions { background: [0.0, f64::INFINITY, 0.0], ..good }).contains("`background`"));
    }
}
