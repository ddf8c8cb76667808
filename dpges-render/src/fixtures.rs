//! Cameras and scenes for tests.

use dpges_core::camera::{Camera, CameraFromWorld};
use dpges_core::scene::{GaussianData, SceneData, SceneInfo, SurfelData};
use glam::DVec3;

/// A camera of 64 × 48 px at `eye` that looks at the origin, with z upwards.
pub fn camera(eye: [f64; 3], focal_px: f64) -> Camera {
    pinhole(CameraFromWorld::look_at(eye.into(), DVec3::ZERO, DVec3::Z), focal_px, [64, 48])
}

/// The principal point is in the middle.
pub fn pinhole(camera_from_world: CameraFromWorld, focal_px: f64, size: [usize; 2]) -> Camera {
    Camera::pinhole(camera_from_world, focal_px, size, 0.01)
}

/// Unit vectors, spread evenly over the sphere.
pub fn directions(count: u32) -> impl Iterator<Item = DVec3> {
    let golden_angle = 2.399_963_229_728_653;
    (0..count).map(move |index| {
        let z = 1.0 - (2.0 * f64::from(index) + 1.0) / f64::from(count);
        let (sin, cos) = (golden_angle * f64::from(index)).sin_cos();
        DVec3::new((1.0 - z * z).sqrt() * cos, (1.0 - z * z).sqrt() * sin, z)
    })
}

/// Surfels and Gaussians of which nothing is known.
pub fn neutral(info: SceneInfo, [surfels, gaussians]: [usize; 2]) -> SceneData {
    let model = info.colour_model;
    let (surfels, gaussians) = (SurfelData::neutral(model, surfels), GaussianData::neutral(model, gaussians));
    SceneData { info, surfels, gaussians, environment: None }
}
