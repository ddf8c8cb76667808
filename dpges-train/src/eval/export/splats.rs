//! Splats that stand for a scene, trained a little further if asked to.

use std::path::Path;

use burn::tensor::Device;
use dpges_core::Result;
use dpges_core::scene::{Rendering, SceneData, ScreenFilter};
use dpges_render::export::sog::to_sog;
use dpges_render::export::spz::{SpzVersion, to_spz};
use dpges_render::export::{
    Coordinates, ExportError, MAX_DEGREE, SplatCloud, flatten, read_splats, to_glb, to_ply, to_usda, to_usdz,
};

use super::ExportFailure;
use crate::dataset::View;
use crate::eval::evaluate;
use crate::eval::splat_fit::fit;

/// Steps of a fit between two lines about it.
const REPORT_EVERY: usize = 50;

/// Formats of splats.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SplatFormat {
    Ply,
    Spz(SpzVersion),
    Sog,
    Glb,
    Usda,
    Usdz,
}

/// The filter of the programs that show splats of `scene`, unless it is given: that of blended Gaussians.
pub fn filter_of(scene: &SceneData) -> ScreenFilter {
    match scene.info.rendering {
        Rendering::Ellipsoids => scene.info.screen_filter,
        _ => ScreenFilter::Compensated,
    }
}

/// Whether splats of `scene` that are shown with `filter` are no more than an approximation, which a fit makes better.
pub fn is_changed(scene: &SceneData, filter: ScreenFilter) -> bool {
    scene.info.rendering == Rendering::Peeled || filter != filter_of(scene)
}

/// The splats of `scene` with harmonics of `degree` for programs with `filter`, trained for `steps` on `views`.
///
/// # Errors
/// The errors of [`flatten()`] and [`fit`].
pub fn splats(
    scene: &SceneData,
    degree: usize,
    filter: ScreenFilter,
    steps: usize,
    views: &[View],
    device: &Device,
) -> Result<SplatCloud, ExportFailure> {
    let mut cloud = flatten(scene, degree.min(MAX_DEGREE))?;
    cloud.info.screen_filter = filter;
    if steps == 0 {
        return Ok(cloud);
    }
    // with what lies behind, which the formats have no place for: splats do not have to make up for it
    let start = SceneData { environment: scene.environment.clone(), ..cloud.to_scene() };
    let fitted = fit(&start, views, steps, device, |completed| {
        if completed % REPORT_EVERY == 0 || completed == steps {
            tracing::info!("splats: step {completed}/{steps}");
        }
    })?;
    Ok(flatten(&fitted, degree)?)
}

/// The bytes of a file of `cloud`. Only PLY has coordinates of the dataset.
///
/// # Errors
/// The errors of the format.
pub fn file(cloud: &SplatCloud, format: SplatFormat, coordinates: Coordinates) -> Result<Vec<u8>, ExportError> {
    match format {
        SplatFormat::Ply => Ok(to_ply(cloud, coordinates)),
        SplatFormat::Glb => to_glb(cloud),
        SplatFormat::Spz(version) => to_spz(cloud, version),
        SplatFormat::Sog => to_sog(cloud),
        SplatFormat::Usda => Ok(to_usda(cloud).into_bytes()),
        SplatFormat::Usdz => to_usdz(cloud),
    }
}

/// PSNR of `scene`, and of what the `bytes` of a file of `cloud` hold, mean over `views`, dB. OpenUSD is not read again: it has
/// every bit of the cloud.
///
/// # Errors
/// The errors of [`evaluate`]; [`ExportError::Malformed`] if the file cannot be read again.
pub fn loss(
    scene: &SceneData,
    cloud: &SplatCloud,
    format: SplatFormat,
    bytes: &[u8],
    views: &[View],
    device: &Device,
) -> Result<[f64; 2], ExportFailure> {
    let malformed = |reason| ExportError::Malformed { format: "exported", reason };
    let read = || read_splats(bytes, Path::new("")).unwrap_or_else(|| Err("it holds no splats".to_owned()));
    let held = match format {
        SplatFormat::Usda | SplatFormat::Usdz => cloud.to_scene(),
        _ => read().map_err(malformed)?.scene,
    };
    let held = held.relocated(scene.info.offset);
    Ok([evaluate(scene, views, device)?.psnr, evaluate(&held, views, device)?.psnr])
}
