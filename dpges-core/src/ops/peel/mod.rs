//! `peel`: the surfel fragments of every pixel that its picture is made of, nearest first.
//!
//! Surfels → ids, opacity and depth, each [K, H, W] (plane k is layer k), ordered by (depth, index). A missing layer has
//! id −1, alpha 0 and depth +∞. A *core* is a fragment of opacity 1.
//! * [`Peeling::Continuous`]: the nearest core, and the K − 1 nearest of the other fragments up to [`ORDER`] ε behind it, with
//!   the margin ε of its surfel; without a core the K − 1 nearest. Opacity is `clamp((R² − u² − v²) slope, 0, 1)` at the hit of the
//!   ray through the pixel's centre with the surfel's plane, (u, v) in σ: 1 where w G ≥ 1, 0 where the surfel ends.
//! * otherwise: the K nearest, none behind a core, with opacity `min(1, w G)`, `G = exp(−(u² + v²) / 2)` (DP-GES, "surfel
//!   opacity").
//!
//! Gradients: from alpha and from depth to positions, quaternions and log-scales. A core's alpha has none. Which fragment
//! forms which layer carries none.

mod autodiff;
mod cpu;
#[cfg(feature = "gpu")]
mod cube;
#[cfg(test)]
mod tests;

use burn::backend::tensor::{FloatTensor, IntTensor};
use burn::backend::{Backend, Dispatch, ExtensionType, backend_extension};
use burn::tensor::{Int, Tensor};

use crate::camera::Camera;
use crate::error::{Error, Result};
#[cfg(doc)]
use crate::scene::peeling::ORDER;
use crate::scene::tensors::flat;
use crate::scene::{Footprint, Peeling, SceneInfo, Surfels};
use crate::tiles::capacity::within_capacity;

/// Largest number of layers.
pub const MAX_LAYERS: usize = 8;

/// Number and opacity of layers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PeelOptions {
    /// K, 1 to [`MAX_LAYERS`].
    pub layer_count: usize,
    /// w: a surfel is opaque where w G ≥ 1.
    pub modulation: f64,
    pub footprint: Footprint,
    pub peeling: Peeling,
}

impl Default for PeelOptions {
    /// Those of a scene by default.
    fn default() -> Self {
        Self::from(&SceneInfo::default())
    }
}

impl From<&SceneInfo> for PeelOptions {
    fn from(info: &SceneInfo) -> Self {
        let &SceneInfo { layer_count, modulation, footprint, peeling, .. } = info;
        Self { layer_count, modulation, footprint, peeling }
    }
}

impl PeelOptions {
    /// # Errors
    /// [`Error::Option`] for a layer count outside 1..=8 or a modulation that is not positive and finite in f32.
    pub fn validate(&self) -> Result<()> {
        if !(1..=MAX_LAYERS).contains(&self.layer_count) {
            let expected = format!("1 to {MAX_LAYERS}");
            return Err(Error::Option { option: "layer_count", expected, found: self.layer_count.to_string() });
        }
        let modulation = self.modulation as f32;
        if !(modulation.is_finite() && modulation > 0.0) {
            let found = self.modulation.to_string();
            return Err(Error::Option {
                option: "modulation",
                expected: "a positive, finite 32-bit number".into(),
                found,
            });
        }
        Ok(())
    }
}

/// Peeled layers of one view.
#[derive(Clone, Debug)]
pub struct Layers {
    /// [K, H, W] surfel index, −1 where there is no layer
    pub ids: Tensor<3, Int>,
    /// [K, H, W] opacity, 0 where there is no layer
    pub alpha: Tensor<3>,
    /// [K, H, W] depth of the hit, world units, +∞ where there is no layer
    pub depth: Tensor<3>,
}

#[derive(ExtensionType, Debug, Clone)]
pub struct PeelOutput<B: Backend> {
    pub ids: IntTensor<B>,
    pub alpha: FloatTensor<B>,
    pub depth: FloatTensor<B>,
}

/// The attributes of surfels that [`peel`] depends on.
#[derive(ExtensionType, Debug, Clone)]
pub struct SurfelShapes<B: Backend> {
    /// [N, 3]
    pub positions: FloatTensor<B>,
    /// [N, 4]
    pub quaternions: FloatTensor<B>,
    /// [N, 2]
    pub log_scales: FloatTensor<B>,
    /// `[N]`, without gradient
    pub margins: FloatTensor<B>,
}

impl<B: Backend> SurfelShapes<B> {
    /// In the order of the fields.
    fn into_array(self) -> [FloatTensor<B>; 4] {
        [self.positions, self.quaternions, self.log_scales, self.margins]
    }

    /// In the order of the fields.
    fn from_array([positions, quaternions, log_scales, margins]: [FloatTensor<B>; 4]) -> Self {
        Self { positions, quaternions, log_scales, margins }
    }
}

/// The state for the backward pass from alpha and depth.
#[derive(Debug, Clone)]
pub struct PeelState<B: Backend> {
    surfels: SurfelShapes<B>,
    ids: IntTensor<B>,
    camera: Camera,
    options: PeelOptions,
}

#[backend_extension(
    Cube: cfg(feature = "gpu"),
    NdArray: cfg(feature = "ndarray"),
    Flex: cfg(feature = "flex"),
    Autodiff
)]
pub trait PeelOps: Backend {
    fn peel(#[extension_type] surfels: SurfelShapes<Self>, camera: Camera, options: PeelOptions) -> PeelOutput<Self>;
}

/// Peels `surfels`.
///
/// # Errors
/// [`Error::Shape`], [`Error::Camera`] or [`Error::Option`] if the input is invalid, [`Error::Capacity`] if the tile lists or
/// the layers do not fit a buffer.
pub fn peel(surfels: &Surfels, camera: &Camera, options: &PeelOptions) -> Result<Layers> {
    camera.validate()?;
    options.validate()?;
    surfels.check_shapes()?;
    let Surfels { positions, quaternions, log_scales, margins, .. } = surfels;
    let surfels = SurfelShapes {
        positions: positions.clone().into_dispatch(),
        quaternions: quaternions.clone().into_dispatch(),
        log_scales: log_scales.clone().into_dispatch(),
        margins: flat(margins).into_dispatch(),
    };
    let out = within_capacity(|| Dispatch::peel(surfels, *camera, *options))?;
    Ok(Layers {
        ids: Tensor::from_dispatch(out.ids),
        alpha: Tensor::from_dispatch(out.alpha),
        depth: Tensor::from_dispatch(out.depth),
    })
}
