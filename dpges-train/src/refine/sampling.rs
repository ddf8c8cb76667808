//! How fine the training views resolve the scene (Mip-Splatting).

use dpges_core::camera::Camera;
use glam::{DVec3, Vec3};
use rayon::prelude::*;

/// A point counts as seen up to this fraction of the picture outside it (Mip-Splatting).
const MARGIN: f64 = 0.15;

/// `[N]` width of a pixel at each of `positions` [N × 3] (world units) in the view of `cameras` that resolves it best:
/// depth over focal length, world units per px. Where no view sees a point, the `coarsest` of all ranks, whose argument is the
/// largest of the others; 0 if none is seen.
pub fn finest_pixels(positions: &[f32], cameras: &[&Camera], coarsest: impl FnOnce(f64) -> f64) -> Vec<f32> {
    let points = positions.as_chunks::<3>().0;
    let finest = |point: &[f32; 3]| {
        let world = Vec3::from_array(*point).as_dvec3();
        cameras.iter().filter_map(|camera| pixel(camera, world)).fold(f64::INFINITY, f64::min)
    };
    let mut pixels: Vec<f64> = points.par_iter().map(finest).collect();
    let coarsest = coarsest(pixels.iter().copied().filter(|pixel| pixel.is_finite()).fold(0.0, f64::max));
    pixels.iter_mut().filter(|pixel| !pixel.is_finite()).for_each(|pixel| *pixel = coarsest);
    pixels.into_iter().map(|pixel| pixel as f32).collect()
}

/// Width of a pixel of `camera` at a point that it sees.
fn pixel(camera: &Camera, world: DVec3) -> Option<f64> {
    let (x, y, depth) = camera.project(world)?;
    let inside = |at: f64, size: usize| (-MARGIN * size as f64..=(1.0 + MARGIN) * size as f64).contains(&at);
    // the larger focal length gives the finer side of a pixel
    (inside(x, camera.width) && inside(y, camera.height)).then(|| depth / camera.fx.max(camera.fy))
}

#[cfg(test)]
mod tests {
    use dpges_core::camera::CameraFromWorld;

    use super::*;
    use crate::run::fixtures;

    fn camera(distance: f64, focal: f64) -> Camera {
        let pose = CameraFromWorld::look_at(DVec3::new(0.0, 0.0, -distance), DVec3::ZERO, -DVec3::Y);
        fixtures::camera(pose, focal, [40, 40])
    }

    #[test]
    fn the_nearest_view_that_sees_a_point_decides() {
        let (near, far) = (camera(2.0, 100.0), camera(8.0, 100.0));
        let away = CameraFromWorld::look_at(DVec3::new(0.0, 0.0, 30.0), DVec3::new(0.0, 0.0, 60.0), -DVec3::Y);
        let away = Camera { camera_from_world: away, ..camera(2.0, 1e6) };
        let cameras = [&far, &near, &away];
        // in the middle; 1 to the side: 50 px of the near view, 12.5 of the far; beyond both; behind them
        let positions = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 9.0, 0.0, 0.0, 0.0, 0.0, -20.0];
        let found = finest_pixels(&positions, &cameras, |own| own);
        for (found, expected) in found.iter().zip([0.02, 0.08, 0.08, 0.08]) {
            assert!((found - expected).abs() < 1e-6, "{found}, expected {expected}");
        }
        assert_eq!(finest_pixels(&positions[6..9], &cameras, |own| own), [0.0]);
        assert!(finest_pixels(&[], &cameras, |own| own).is_empty());
    }
}
