//! Splats that stand for a scene, trained a little further if asked to.

use burn::tensor::Device;
use dpges_core::Result;
use dpges_core::scene::SceneData;
use dpges_render::export::spz::{SpzVersion, from_spz, to_spz};
use dpges_render::export::{ExportError, SplatCloud, UpAxis, flatten, to_glb, to_ply};

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
    Glb,
}

/// The splats of `scene` with harmonics of `degree`, trained for `steps` on `views`.
///
/// # Errors
/// The errors of [`flatten()`] and [`fit`].
pub fn splats(
    scene: &SceneData,
    degree: usize,
    steps: usize,
    views: &[View],
    device: &Device,
) -> Result<SplatCloud, ExportFailure> {
    let cloud = flatten(scene, degree)?;
    if steps == 0 {
        return Ok(cloud);
    }
    let fitted = fit(&in_front_of(&cloud, scene), views, steps, device, |completed| {
        if completed % REPORT_EVERY == 0 || completed == steps {
            tracing::info!("splats: step {completed}/{steps}");
        }
    })?;
    Ok(flatten(&fitted, degree)?)
}

/// The bytes of a file of `cloud`, and the splats that it holds.
///
/// # Errors
/// The errors of the format.
pub fn file(cloud: SplatCloud, format: SplatFormat, up: UpAxis) -> Result<(Vec<u8>, SplatCloud), ExportError> {
    Ok(match format {
        SplatFormat::Ply => (to_ply(&cloud, up), cloud),
        SplatFormat::Glb => (to_glb(&cloud, up)?, cloud),
        SplatFormat::Spz(version) => {
            let bytes = to_spz(&cloud, up, version)?;
            let held = from_spz(&bytes)?.rotated(up.to_rub().transpose());
            (bytes, SplatCloud { info: cloud.info, ..held })
        }
    })
}

/// PSNR of `scene` and of `cloud` in its place, mean over `views`, dB.
///
/// # Errors
/// The errors of [`evaluate`].
pub fn loss(scene: &SceneData, cloud: &SplatCloud, views: &[View], device: &Device) -> Result<[f64; 2]> {
    let before = evaluate(scene, views, device)?.psnr;
    Ok([before, evaluate(&in_front_of(cloud, scene), views, device)?.psnr])
}

/// The scene of `cloud` with what lies behind `scene`, which the formats have no place for.
fn in_front_of(cloud: &SplatCloud, scene: &SceneData) -> SceneData {
    SceneData { environment: scene.environment.clone(), ..cloud.to_scene() }
}
