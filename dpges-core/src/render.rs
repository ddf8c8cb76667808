//! One view of a scene, from parameters to pixels.

use burn::tensor::{DType, Tensor};

use crate::camera::Camera;
use crate::error::{Error, Result};
use crate::ops::colour::colour;
use crate::ops::composite::{Composite, CompositeOptions, composite};
use crate::ops::finite::check_finite;
use crate::ops::peel::{Layers, PeelOptions, peel};
use crate::ops::splat::limits::interval_limits;
use crate::ops::splat::splat;
use crate::scene::{Gaussians, SceneInfo, Surfels};

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RenderOptions {
    pub peel: PeelOptions,
    /// C_b, display-referred.
    pub background: [f64; 3],
    /// Stop the gradient from the Gaussians to the surfels (ablation).
    pub detach_transmittance: bool,
}

impl Default for RenderOptions {
    fn default() -> Self {
        Self { peel: PeelOptions::default(), background: [0.0; 3], detach_transmittance: false }
    }
}

impl From<&SceneInfo> for RenderOptions {
    fn from(info: &SceneInfo) -> Self {
        Self { peel: PeelOptions::from(info), background: info.background, detach_transmittance: false }
    }
}

/// A rendered view. Images are [C, H, W] in display-referred values and not clamped.
#[derive(Clone, Debug)]
pub struct Render {
    /// Image, surfel image, transmittance, Gaussian colour and weight.
    pub composite: Composite,
    pub layers: Layers,
    /// [K, H, W] upper limits of the depth intervals.
    pub limits: Tensor<3>,
    /// [N, 3] colours of the surfels from this camera.
    pub surfel_colours: Tensor<2>,
    /// [M, 3] colours of the Gaussians from this camera.
    pub gaussian_colours: Tensor<2>,
}

/// Checks shapes, element types and finiteness of everything that is rendered.
///
/// # Errors
/// [`Error::Shape`], [`Error::DType`] or [`Error::NonFinite`] naming the tensor.
pub fn validate(surfels: &Surfels, gaussians: &Gaussians) -> Result<()> {
    surfels.check_shapes()?;
    gaussians.check_shapes()?;
    let dtype = surfels.positions.dtype();
    for (name, colour) in [("surfels", &surfels.colour), ("gaussians", &gaussians.colour)] {
        check(&format!("{name}.colour.base"), &colour.base, dtype)?;
        check(&format!("{name}.colour.detail"), &colour.detail, dtype)?;
    }
    check("surfels.positions", &surfels.positions, dtype)?;
    check("surfels.quaternions", &surfels.quaternions, dtype)?;
    check("surfels.log_scales", &surfels.log_scales, dtype)?;
    check("surfels.margins", &surfels.margins, dtype)?;
    check("gaussians.positions", &gaussians.positions, dtype)?;
    check("gaussians.quaternions", &gaussians.quaternions, dtype)?;
    check("gaussians.log_scales", &gaussians.log_scales, dtype)?;
    check("gaussians.opacities", &gaussians.opacities, dtype)
}

fn check<const D: usize>(name: &str, tensor: &Tensor<D>, dtype: DType) -> Result<()> {
    if !matches!(dtype, DType::F32 | DType::F64) || tensor.dtype() != dtype {
        let expected = format!("F32 or F64, the same for all (`surfels.positions` has {dtype:?})");
        return Err(Error::DType { tensor: name.into(), expected, found: format!("{:?}", tensor.dtype()) });
    }
    check_finite(name, tensor)
}

/// Renders `surfels` and `gaussians` from `camera` (DP-GES).
///
/// # Errors
/// A typed error naming what does not fit: see [`validate`], [`Camera::validate`], [`PeelOptions::validate`].
pub fn render(surfels: &Surfels, gaussians: &Gaussians, camera: &Camera, options: &RenderOptions) -> Result<Render> {
    camera.validate()?;
    options.peel.validate()?;
    validate(surfels, gaussians)?;
    let centre = camera.centre().to_array();
    let surfel_colours = colour(&surfels.colour, &surfels.positions, centre)?;
    let gaussian_colours = colour(&gaussians.colour, &gaussians.positions, centre)?;
    let layers = peel(
        surfels.positions.clone(),
        surfels.quaternions.clone(),
        surfels.log_scales.clone(),
        camera,
        &options.peel,
    )?;
    let limits = interval_limits(&layers, surfels.margins.clone())?;
    let sums = splat(gaussians, gaussian_colours.clone(), limits.clone(), camera)?;
    let blending =
        CompositeOptions { background: options.background, detach_transmittance: options.detach_transmittance };
    let composite = composite(&layers, surfel_colours.clone(), sums, blending)?;
    Ok(Render { composite, layers, limits, surfel_colours, gaussian_colours })
}
