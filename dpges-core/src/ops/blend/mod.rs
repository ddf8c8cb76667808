//! `blend`: primitives blended front to back in the order of their depths (3DGS, 2DGS).
//!
//! Primitives, coloured c_i, → planes [P, H, W] and median depth. With `T_i = Π_{j<i} (1 − α_j)` and
//! `w_i = α_i T_i`, the planes are
//!
//! | plane | value | |
//! |---|---|---|
//! | 0–2 | `Σ w_i c_i` | colour, without a background |
//! | 3 | `Σ w_i = 1 − T` | alpha |
//! | 4 | `Σ w_i z_i` | expected depth, not divided by alpha, world units |
//! | 5–7 | `Σ w_i n_i` | normal, camera axes, facing the camera |
//! | 8 | `Σ_{j<i} w_i w_j (m_i − m_j)²` | depth distortion (2DGS), m of z see [`far`] |
//!
//! P is 4, or 9 with [`BlendOptions::maps`]. Median depth is the z_i of the first fragment behind which
//! T ≤ ½, or 0 if there is none (2DGS). All pixels share one order of primitives: by depth of the
//! centre, then by index. A primitive whose centre is at or behind the near plane does not exist. A pixel
//! ends before the first fragment that would take T below [`BlendOptions::min_transmittance`]. α is capped
//! at [`BlendOptions::max_alpha`], and a fragment with α below 1/255 does not exist.
//!
//! [`Form::Ellipsoids`]: α = max(0, opacity) · compensation · exp(−½ dᵀ Q d), the footprint of
//! [`splat`](super::splat): EWA, a low-pass filter of 0.1 px², compensation; or, with [`ScreenFilter::Plain`],
//! 0.3 px² without compensation (3DGS, DBS). Gaussians trained that way change when they are splatted. z is that
//! of the centre, n the axis with the smallest scale.
//!
//! [`Form::Discs`]: α = max(0, opacity) · exp(−ρ/2) with ρ = min(u² + v², 2 |d|²): (u, v) in units of the
//! first two scales is where the ray meets the disc, d the distance in px from the centre of the box
//! around the disc at 3 σ. The second term is the low-pass filter of 2DGS; a disc that reaches the plane of
//! the camera at 3 σ has none. z is that of the hit with either term. A hit at or nearer than the near plane
//! does not exist. n is the third axis. The third scale is unused.
//!
//! Gradients: from the planes to positions, quaternions, log-scales, opacities and colours, all in one
//! pass. Median depth, a capped α, the order, the end of a pixel and the choice of a normal carry none.
//!
//! The *probe* is a [M, 4] tensor that no value depends on. Its gradient is Σ g_x, Σ g_y, Σ |g_x|, Σ |g_y|
//! over the pixels, where (g_x, g_y) is a pixel's gradient with respect to the projected centre in units
//! of half the image. 3DGS, 2DGS (only from hits with the disc) and AbsGS base densification on it.

mod backward;
mod cpu;
#[cfg(feature = "gpu")]
mod cube;
#[cfg(test)]
mod tests;

use burn::backend::tensor::{FloatTensor, IntTensor};
use burn::backend::{Backend, Dispatch, ExtensionType, backend_extension};
use burn::tensor::Tensor;

use crate::camera::Camera;
use crate::error::{Error, Result};
use crate::footprint::gaussian::tensors::GaussianTensors;
use crate::scene::tensors::check_shape;
use crate::scene::{Gaussians, ScreenFilter};
use crate::tiles::capacity::within_capacity;

/// Red, green, blue, alpha.
pub const COLOUR_PLANES: usize = 4;
/// The planes above, expected depth, three of the normal, distortion.
pub const ALL_PLANES: usize = 9;
pub const ALPHA_PLANE: usize = 3;
pub const DEPTH_PLANE: usize = 4;
/// The first of three.
pub const NORMAL_PLANE: usize = 5;
pub const DISTORTION_PLANE: usize = 8;

/// Largest [`BlendOptions::max_alpha`]: backward divides by 1 − α.
pub const HIGHEST_MAX_ALPHA: f64 = 0.9999;

/// Depth that distortion maps to 1, world units, unless the near plane is close to it (2DGS).
pub const FAR: f64 = 100.0;

/// Depth that distortion maps to 1: m = far / (far − near) · (1 − near / z). [`FAR`], but at least 10 · `near`.
pub fn far(near: f64) -> f64 {
    FAR.max(10.0 * near)
}

/// Form of the primitives.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Form {
    /// Three scales, projected as a whole (3DGS).
    #[default]
    Ellipsoids,
    /// Two scales, met by rays (2DGS).
    Discs,
}

/// Form of the primitives and thresholds of blending.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BlendOptions {
    pub form: Form,
    /// The filter of ellipsoids.
    pub filter: ScreenFilter,
    /// Largest α of a fragment; above 0, at most [`HIGHEST_MAX_ALPHA`].
    pub max_alpha: f64,
    /// Smallest T at which a pixel ends; between 0 and 1.
    pub min_transmittance: f64,
    /// Whether to compute depth, normal and distortion.
    pub maps: bool,
}

impl Default for BlendOptions {
    /// Ellipsoids, α up to 0.999 (DBS), pixels end at 1e-4 (3DGS), no maps.
    fn default() -> Self {
        Self {
            form: Form::Ellipsoids,
            filter: ScreenFilter::default(),
            max_alpha: 0.999,
            min_transmittance: 1e-4,
            maps: false,
        }
    }
}

impl BlendOptions {
    /// # Errors
    /// [`Error::Option`] for a number outside its range.
    pub fn validate(&self) -> Result<()> {
        let check = |option, value: f64, fits: bool, expected: String| {
            if fits { Ok(()) } else { Err(Error::Option { option, expected, found: value.to_string() }) }
        };
        let (alpha, through) = (self.max_alpha, self.min_transmittance);
        let at_most = format!("a number above 0 and at most {HIGHEST_MAX_ALPHA}");
        check("max_alpha", alpha, alpha > 0.0 && alpha <= HIGHEST_MAX_ALPHA, at_most)?;
        check("min_transmittance", through, through > 0.0 && through < 1.0, "a number between 0 and 1".into())
    }

    /// P
    pub fn planes(&self) -> usize {
        if self.maps { ALL_PLANES } else { COLOUR_PLANES }
    }
}

/// Primitives and the probe, or the gradients with respect to them.
#[derive(ExtensionType, Debug, Clone)]
pub struct BlendInput<B: Backend> {
    #[extension_type]
    pub gaussians: GaussianTensors<B>,
    /// [M, 4], or [0, 4] without a probe
    pub probe: FloatTensor<B>,
}

/// Primitives in the order of their depths and by tile, which backward needs again. CPU backends make them anew, and
/// these are empty.
#[derive(ExtensionType, Debug, Clone)]
pub struct BlendLists<B: Backend> {
    /// `[M]` index of each primitive, nearest first; what follows counts them in this order
    pub order: IntTensor<B>,
    /// [M + 1] first pair of each primitive and a tile that it may touch
    pub starts: IntTensor<B>,
    /// `[pairs]` the pairs by tile, each tile's in the order of the primitives, and last those that do not touch, and
    /// places without a pair
    pub pairs: IntTensor<B>,
    /// `[pairs]` primitives of those; of any value where there is no pair
    pub primitives: IntTensor<B>,
    /// [tiles + 1] first of those of each tile
    pub offsets: IntTensor<B>,
}

impl<B: Backend> BlendLists<B> {
    /// In the order of the fields.
    pub fn from_array([order, starts, pairs, primitives, offsets]: [IntTensor<B>; 5]) -> Self {
        Self { order, starts, pairs, primitives, offsets }
    }
}

#[derive(ExtensionType, Debug, Clone)]
pub struct BlendOutput<B: Backend> {
    /// [P, H, W]
    pub planes: FloatTensor<B>,
    /// [1, H, W] world units, 0 where T stays above ½; no gradient. May be empty without maps.
    pub median_depth: FloatTensor<B>,
    #[extension_type]
    pub lists: BlendLists<B>,
}

#[backend_extension(
    Cube: cfg(feature = "gpu"),
    NdArray: cfg(feature = "ndarray"),
    Flex: cfg(feature = "flex"),
    Autodiff
)]
pub trait BlendOps: Backend {
    fn blend(#[extension_type] input: BlendInput<Self>, camera: Camera, options: BlendOptions) -> BlendOutput<Self>;
}

#[backend_extension(Cube: cfg(feature = "gpu"), NdArray: cfg(feature = "ndarray"), Flex: cfg(feature = "flex"))]
pub trait BlendBackwardOps: Backend {
    /// Gradients with respect to the input, from that with respect to the planes, [P, H, W], and the lists of the
    /// output.
    fn blend_backward(
        #[extension_type] input: BlendInput<Self>,
        #[extension_type] lists: BlendLists<Self>,
        grad: FloatTensor<Self>,
        camera: Camera,
        options: BlendOptions,
    ) -> BlendInput<Self>;
}

/// Blended primitives of one view.
#[derive(Clone, Debug)]
pub struct Blend {
    /// [3, H, W] not clamped, nothing behind the primitives
    pub colour: Tensor<3>,
    /// [1, H, W] 1 − T
    pub alpha: Tensor<3>,
    /// With [`BlendOptions::maps`].
    pub maps: Option<Maps>,
}

/// Geometry of one view.
#[derive(Clone, Debug)]
pub struct Maps {
    /// [1, H, W] world units, weighted by αT and not divided by alpha
    pub depth: Tensor<3>,
    /// [1, H, W] world units, 0 where T stays above ½; no gradient
    pub median_depth: Tensor<3>,
    /// [3, H, W] camera axes, facing the camera, weighted by αT
    pub normal: Tensor<3>,
    /// [1, H, W]
    pub distortion: Tensor<3>,
}

/// Blends `gaussians` in `colours` [M, 3], as seen from the camera. Only the gradient of `probe` [M, 4] means anything:
/// Σ g_x, Σ g_y, Σ |g_x|, Σ |g_y| over the pixels, with the gradient with respect to the projected centre in units of
/// half the image.
///
/// # Errors
/// [`Error::Shape`], [`Error::Camera`] or [`Error::Option`] if the input is invalid, [`Error::Capacity`] if the tile lists or
/// the planes do not fit a buffer.
pub fn blend(
    gaussians: &Gaussians,
    colours: &Tensor<2>,
    probe: Option<&Tensor<2>>,
    camera: &Camera,
    options: &BlendOptions,
) -> Result<Blend> {
    camera.validate()?;
    if options.form == Form::Discs {
        camera.require_pinhole()?;
    }
    options.validate()?;
    let probe = match probe {
        Some(probe) => {
            check_shape("probe", probe, [gaussians.len(), 4])?;
            probe.clone()
        }
        None => Tensor::zeros([0, 4], (&colours.device(), colours.dtype())),
    };
    let input = BlendInput { gaussians: GaussianTensors::new(gaussians, colours)?, probe: probe.into_dispatch() };
    let out = within_capacity(|| Dispatch::blend(input, *camera, *options))?;
    let planes = Tensor::<3>::from_dispatch(out.planes);
    let part =
        |first: usize, count: usize| planes.clone().slice([first..first + count, 0..camera.height, 0..camera.width]);
    let maps = options.maps.then(|| Maps {
        depth: part(DEPTH_PLANE, 1),
        median_depth: Tensor::from_dispatch(out.median_depth),
        normal: part(NORMAL_PLANE, 3),
        distortion: part(DISTORTION_PLANE, 1),
    });
    Ok(Blend { colour: part(0, 3), alpha: part(ALPHA_PLANE, 1), maps })
}
