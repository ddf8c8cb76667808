//! Which way is up in a world whose axes say nothing about it.

use dpges_core::camera::Camera;
use glam::DVec3;
use nalgebra::{Matrix3, SymmetricEigen, Vector3};

/// Weight of the mean upward axis of the cameras against the horizontal ones. It decides where these span no plane.
const UPRIGHT: f64 = 0.05;

/// The direction that is up in the world: perpendicular to the horizontal axes of the cameras, which photographers hold
/// level, however much they tilt them.
pub fn upwards<'a>(cameras: impl Iterator<Item = &'a Camera>) -> DVec3 {
    let (mut level, mut upright, mut count) = (Matrix3::zeros(), Vector3::zeros(), 0.0);
    for camera in cameras {
        let world_from_camera = camera.camera_from_world.rotation.transpose();
        let right = Vector3::from((world_from_camera * DVec3::X).to_array());
        level += right * right.transpose();
        upright -= Vector3::from((world_from_camera * DVec3::Y).to_array());
        count += 1.0;
    }
    let upright = upright.try_normalize(0.0).unwrap_or_else(|| -Vector3::y());
    let eigen = SymmetricEigen::new(level / f64::max(count, 1.0) - UPRIGHT * upright * upright.transpose());
    let up = eigen.eigenvectors.column(eigen.eigenvalues.imin()).into_owned();
    DVec3::from_array(if up.dot(&upright) < 0.0 { -up } else { up }.into())
}
