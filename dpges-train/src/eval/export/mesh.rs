//! A mesh of the surfels of a scene, as the training views see them.

use burn::tensor::Device;
use dpges_core::camera::Camera;
use dpges_core::scene::SceneData;
use dpges_core::scene::tensors::tensor_to_rows;
use dpges_render::export::ExportError;
use dpges_render::export::mesh::{DepthView, Fusion, FusionOptions, SurfaceSample, TriangleMesh};

use super::ExportFailure;
use crate::dataset::View;
use crate::device::memory::machine_memory_bytes;
use crate::eval::rendered::TrainingRenderer;

/// Surfels farther than this are not meshed, extents.
const FARTHEST_EXTENTS: f64 = 4.0;

/// Voxels that memory is taken for: 640 MB of them, or a sixteenth of the memory of the machine, but no more than a quarter.
const VOXEL_BYTES: u64 = 20;
const MOST_BYTES: u64 = 640_000_000;
/// Views, and points of them, that decide on the size of voxels.
const SAMPLED_VIEWS: usize = 64;
const SAMPLED_POINTS: usize = 200_000;

/// The mesh of `scene` as `views` see it, and the size of its voxels, world units: `voxel`, or else as fine as the views, or as
/// memory allows.
///
/// # Errors
/// [`ExportError::SmallestVoxel`] if memory does not allow `voxel`; [`ExportError::NoSurfels`] and others.
pub fn mesh(
    scene: &SceneData,
    views: &[View],
    voxel: Option<f64>,
    device: &Device,
) -> Result<(TriangleMesh, f64), ExportFailure> {
    if scene.surfels.is_empty() {
        return Err(ExportError::NoSurfels.into());
    }
    let farthest = FARTHEST_EXTENTS * scene.info.extent;
    let memory = machine_memory_bytes().unwrap_or(4 * MOST_BYTES);
    let max_voxels = (MOST_BYTES.max(memory / 16).min(memory / 4) / VOXEL_BYTES) as usize;
    let renderer = TrainingRenderer::new(scene, device);
    let mut sample = SurfaceSample::default();
    let pixels: usize = views.iter().take(SAMPLED_VIEWS).map(|view| view.camera.width * view.camera.height).sum();
    let stride = ((pixels as f64 / SAMPLED_POINTS as f64).sqrt().ceil() as usize).max(1);
    for view in views.iter().step_by(views.len().div_ceil(SAMPLED_VIEWS).max(1)) {
        with_depth(&renderer, &view.camera, |view| sample.add(view, stride, farthest))?;
    }
    let size = match voxel {
        Some(voxel) => {
            let options = FusionOptions::new(voxel);
            Fusion::new(options)?;
            let smallest = sample.smallest_voxel(voxel, max_voxels);
            if smallest > voxel {
                return Err(ExportError::SmallestVoxel { voxel, smallest, limit: max_voxels }.into());
            }
            voxel
        }
        None => sample.voxel(max_voxels)?,
    };
    let mut fusion = Fusion::new(FusionOptions { voxel: size, farthest, max_voxels })?;
    for view in views {
        with_depth(&renderer, &view.camera, |view| fusion.add(view))?;
    }
    Ok((fusion.finish()?, size))
}

/// Calls `use_view` with the surfels as `camera` sees them.
fn with_depth(
    renderer: &TrainingRenderer,
    camera: &Camera,
    use_view: impl FnOnce(&DepthView<'_>) -> Result<(), ExportError>,
) -> Result<(), ExportFailure> {
    let rendered = renderer.render(camera)?;
    let Some(render) = rendered.peeled() else { return Err(ExportError::NoSurfels.into()) };
    let geometry = renderer.geometry(camera, render);
    let behind = tensor_to_rows(&render.seen.behind_all());
    let coverage: Vec<f32> = behind.iter().map(|transmittance| 1.0 - transmittance).collect();
    let blended = tensor_to_rows(&geometry.depth);
    // 0 / 0 where nothing is covered, which is no depth
    let depth: Vec<f32> = blended.iter().zip(&coverage).map(|(depth, coverage)| depth / coverage).collect();
    let colour = tensor_to_rows(&render.composite.image);
    Ok(use_view(&DepthView { camera, depth: &depth, coverage: &coverage, colour: &colour })?)
}
