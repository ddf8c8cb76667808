//! `peel`: the K nearest surfel fragments of every pixel, nearest first.
//!
//! Surfels → ids, opacity and depth, each [K, H, W] (plane k is layer k). Layers are ordered by
//! (depth, index); peeling stops behind an opaque fragment (alpha = 1). With a backstop, the last layer
//! is the nearest opaque fragment if K or more rims lie before it. A missing layer has id −1, alpha 0 and
//! depth +∞. Opacity is `min(1, w G)` with `G = exp(−(u² + v²) / 2)` at the hit of the
//! ray through the pixel's centre with the surfel's plane (DP-GES, "surfel opacity").
//!
//! Gradients: from alpha and from depth to positions, quaternions and log-scales. An opaque
//! fragment's alpha has none. Which fragment forms which layer carries none.

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
use crate::scene::tensors::check_shape;
use crate::scene::{Footprint, SceneInfo};
use crate::tiles::capacity::within_capacity;

/// Largest number of layers.
pub const MAX_LAYERS: usize = 8;

/// Number and opacity of layers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PeelOptions {
    /// K, 1 to [`MAX_LAYERS`].
    pub layer_count: usize,
    /// w: opacity is min(1, w G).
    pub modulation: f64,
    pub footprint: Footprint,
    /// Whether the nearest opaque fragment is always a layer: of the rims before it, the K − 1 nearest are the others.
    /// Otherwise the layers are the K nearest fragments, opaque or not (DP-GES), and what is behind K rims shows through.
    pub backstop: bool,
}

impl Default for PeelOptions {
    /// The options of DP-GES: 3 layers, w = 30, footprint to G = 1/255, no backstop.
    fn default() -> Self {
        Self { layer_count: 3, modulation: 30.0, footprint: Footprint::Kernel, backstop: false }
    }
}

impl From<&SceneInfo> for PeelOptions {
    fn from(info: &SceneInfo) -> Self {
        Self {
            layer_count: info.layer_count,
            modulation: info.modulation,
            footprint: info.footprint,
            backstop: info.backstop,
        }
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
}

impl<B: Backend> SurfelShapes<B> {
    /// In the order of the fields.
    fn into_array(self) -> [FloatTensor<B>; 3] {
        [self.positions, self.quaternions, self.log_scales]
    }

    /// In the order of the fields.
    fn from_array([positions, quaternions, log_scales]: [FloatTensor<B>; 3]) -> Self {
        Self { positions, quaternions, log_scales }
    }
}

/// The output of [`peel`] that an incoming gradient belongs to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PeelGradient {
    Alpha,
    Depth,
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

/// Peels surfels with `positions` [N, 3], `quaternions` [N, 4] and `log_scales` [N, 2].
///
/// # Errors
/// [`Error::Shape`], [`Error::Camera`] or [`Error::Option`] if the input is invalid, [`Error::Capacity`] if the tile lists or
/// the layers do not fit a buffer.
pub fn peel(
    positions: &Tensor<2>,
    quaternions: &Tensor<2>,
    log_scales: &Tensor<2>,
    camera: &Camera,
    options: &PeelOptions,
) -> Result<Layers> {
    camera.validate()?;
    options.validate()?;
    let count = positions.dims()[0];
    check_shape("surfels.positions", positions, [count, 3])?;
    check_shape("surfels.quaternions", quaternions, [count, 4])?;
    check_shape("surfels.log_scales", log_scales, [count, 2])?;
    let surfels =
        SurfelShapes::from_array([positions, quaternions, log_scales].map(|tensor| tensor.clone().into_dispatch()));
    let out = within_capacity(|| Dispatch::peel(surfels, *camera, *options))?;
    Ok(Layers {
        ids: Tensor::from_dispatch(out.ids),
        alpha: Tensor::from_dispatch(out.alpha),
        depth: Tensor::from_dispatch(out.depth),
    })
}
