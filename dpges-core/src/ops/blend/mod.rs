//! `blend`: Gaussians blended front to back in the order of their depths (3DGS).
//!
//! Gaussians, coloured c_i → colour `Σ c_i α_i T_i` [3, H, W] without a background, alpha `1 − T`
//! behind the last Gaussian [1, H, W], expected depth `Σ z_i α_i T_i` [1, H, W], not divided by alpha, and median
//! depth [1, H, W], the z_i of the first Gaussian behind which T ≤ ½, 0 where there is none (2DGS).
//! `T_i = Π_{j<i} (1 − α_j)`; z_i is camera-space z of the centre, world units; Gaussians are ordered by
//! (z_i, index), alike in all pixels. A pixel ends before the first Gaussian that would take T below
//! [`BlendOptions::min_transmittance`].
//!
//! α = min([`BlendOptions::max_alpha`], max(0, opacity) · compensation · exp(−½ dᵀ Q d)), dropped below 1/255, with
//! the footprint of [`splat`]: EWA, 0.1 px² low-pass, compensated. DBS has 0.3 px² and no
//! compensation, but then Gaussians change when they go on to be splatted.
//!
//! Gradients: from colour, alpha and expected depth to positions, quaternions, log-scales, opacities
//! and colours. A capped α, the order, where a pixel ends, and median depth carry none.
//!
//! There are no kernels for GPUs yet.

mod backward;
mod cpu;
#[cfg(test)]
mod tests;

use burn::backend::tensor::FloatTensor;
use burn::backend::{Backend, Dispatch, ExtensionType, backend_extension};
use burn::tensor::Tensor;

use super::splat::{self, SplatInput};
use crate::camera::Camera;
use crate::device::is_gpu;
use crate::error::{Error, Result};
use crate::scene::Gaussians;

/// Largest [`BlendOptions::max_alpha`]: backward divides by 1 − α.
pub const HIGHEST_MAX_ALPHA: f64 = 0.9999;

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BlendOptions {
    /// α of a Gaussian at a pixel is capped here; above 0, at most [`HIGHEST_MAX_ALPHA`].
    pub max_alpha: f64,
    /// A pixel ends before T falls below this; between 0 and 1.
    pub min_transmittance: f64,
}

impl Default for BlendOptions {
    /// α up to 0.999 (DBS), pixels end at 1e-4 (3DGS).
    fn default() -> Self {
        Self { max_alpha: 0.999, min_transmittance: 1e-4 }
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
}

#[derive(ExtensionType, Debug, Clone)]
pub struct BlendOutput<B: Backend> {
    pub colour: FloatTensor<B>,
    pub alpha: FloatTensor<B>,
    pub depth: FloatTensor<B>,
    pub median_depth: FloatTensor<B>,
}

/// Which output an incoming gradient belongs to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OutputKind {
    Colour,
    Alpha,
    Depth,
}

impl OutputKind {
    fn planes(self) -> usize {
        if self == Self::Colour { 3 } else { 1 }
    }

    fn reaches_colours(self) -> bool {
        self == Self::Colour
    }
}

#[backend_extension(NdArray: cfg(feature = "ndarray"), Flex: cfg(feature = "flex"), Autodiff)]
pub trait BlendOps: Backend {
    fn blend(#[extension_type] gaussians: SplatInput<Self>, camera: Camera, options: BlendOptions)
    -> BlendOutput<Self>;
}

#[backend_extension(NdArray: cfg(feature = "ndarray"), Flex: cfg(feature = "flex"))]
pub trait BlendBackwardOps: Backend {
    /// Gradients; that of the colours is empty where the kind of output does not reach them.
    fn blend_backward(
        #[extension_type] gaussians: SplatInput<Self>,
        grad: FloatTensor<Self>,
        kind: OutputKind,
        camera: Camera,
        options: BlendOptions,
    ) -> SplatInput<Self>;
}

/// Blended Gaussians of one view.
#[derive(Clone, Debug)]
pub struct Blend {
    /// [3, H, W] not clamped, nothing behind the Gaussians
    pub colour: Tensor<3>,
    /// [1, H, W] 1 − T
    pub alpha: Tensor<3>,
    /// [1, H, W] world units, weighted by αT and not divided by alpha
    pub depth: Tensor<3>,
    /// [1, H, W] world units, 0 where T stays above ½; no gradient
    pub median_depth: Tensor<3>,
}

/// Blends `gaussians`, coloured `colours` [M, 3] as seen from the camera.
///
/// # Errors
/// [`Error::Shape`], [`Error::Camera`] or [`Error::Option`] for input that does not fit, [`Error::Device`] on a GPU.
pub fn blend(gaussians: &Gaussians, colours: Tensor<2>, camera: &Camera, options: &BlendOptions) -> Result<Blend> {
    camera.validate()?;
    options.validate()?;
    if is_gpu(&colours.device()) {
        return Err(Error::Device { reason: "Gaussians can be blended in order of depth on CPUs only".into() });
    }
    let out = Dispatch::blend(splat::input(gaussians, colours)?, *camera, *options);
    Ok(Blend {
        colour: Tensor::from_dispatch(out.colour),
        alpha: Tensor::from_dispatch(out.alpha),
        depth: Tensor::from_dispatch(out.depth),
        median_depth: Tensor::from_dispatch(out.median_depth),
    })
}
