//! A mesh of the surfels of a scene, as the training views see them.

use burn::tensor::Device;
use dpges_core::scene::SceneData;
use dpges_core::scene::tensors::tensor_to_rows;
use dpges_render::export::ExportError;
use dpges_render::export::mesh::{DepthView, Fusion, FusionOptions, TriangleMesh, depth_map};

use super::ExportFailure;
use crate::dataset::{View, builtin_geometry};
use crate::eval::rendered::Renderer;

/// Surfels farther than this are not meshed, extents.
const FARTHEST_EXTENTS: f64 = 4.0;

/// The mesh of `scene` in voxels of `voxel` world units, as `views` see it.
///
/// # Errors
/// [`ExportError::NoSurfels`] and others.
pub fn mesh(scene: &SceneData, views: &[View], voxel: f64, device: &Device) -> Result<TriangleMesh, ExportFailure> {
    if scene.surfels.is_empty() {
        return Err(ExportError::NoSurfels.into());
    }
    let farthest = FARTHEST_EXTENTS * scene.info.extent;
    let mut fusion = Fusion::new(FusionOptions { farthest, ..FusionOptions::new(voxel) })?;
    let renderer = Renderer::new(scene, device);
    for view in views {
        let rendered = renderer.render(&view.camera)?;
        let Some(render) = rendered.peeled() else { return Err(ExportError::NoSurfels.into()) };
        let geometry = renderer.geometry(&view.camera, render);
        let pixels = view.camera.width * view.camera.height;
        let transmittance = tensor_to_rows(&render.composite.transmittance);
        let behind = &transmittance[transmittance.len() - pixels..];
        let coverage: Vec<f32> = behind.iter().map(|transmittance| 1.0 - transmittance).collect();
        let blended = tensor_to_rows(&geometry.depth);
        // 0 / 0 where nothing is covered, which is no depth
        let depth: Vec<f32> = blended.iter().zip(&coverage).map(|(depth, coverage)| depth / coverage).collect();
        let colour = tensor_to_rows(&render.composite.image);
        fusion.add(&DepthView { camera: &view.camera, depth: &depth, coverage: &coverage, colour: &colour })?;
    }
    Ok(fusion.finish()?)
}

/// How far the mesh is from the ray-traced scene in `views`, in words.
pub fn exact_error(mesh: &TriangleMesh, views: &[View]) -> String {
    let (mut errors, mut missing) = (Vec::new(), 0);
    for view in views {
        let (exact, _) = builtin_geometry(&view.camera);
        for (found, exact) in depth_map(mesh, &view.camera).into_iter().zip(exact) {
            if found > 0.0 { errors.push((found - exact).abs()) } else { missing += 1 }
        }
    }
    if errors.is_empty() {
        return "the held-out views do not show the mesh".to_owned();
    }
    errors.sort_unstable_by(f32::total_cmp);
    let percentile = |share: f64| errors[(share * (errors.len() - 1) as f64).round() as usize];
    let holes = 100.0 * f64::from(missing) / (errors.len() as f64 + f64::from(missing));
    let (median, most) = (percentile(0.5), percentile(0.95));
    format!(
        "off by {median:.4} world units (median), {most:.4} (95th percentile), {holes:.1} % of pixels without a mesh"
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dataset::{BuiltinOptions, builtin};

    #[test]
    fn a_mesh_of_exact_depths_is_near_the_exact_scene() {
        let options =
            BuiltinOptions { width: 64, height: 64, train_views: 12, test_views: 2, points: 0, ..Default::default() };
        let data = builtin(&options);
        let mut fusion = Fusion::new(FusionOptions::new(0.06)).unwrap();
        for view in &data.train {
            let (depth, _) = builtin_geometry(&view.camera);
            let (coverage, colour) = (vec![1.0; depth.len()], &view.picture().unwrap().planes());
            fusion.add(&DepthView { camera: &view.camera, depth: &depth, coverage: &coverage, colour }).unwrap();
        }
        let text = exact_error(&fusion.finish().unwrap(), &data.test);
        let median: f64 = text.split(' ').nth(2).unwrap().parse().unwrap();
        assert!(median < 0.01, "{text}");
        assert!(exact_error(&TriangleMesh::default(), &data.test).contains("do not show"));
    }
}
