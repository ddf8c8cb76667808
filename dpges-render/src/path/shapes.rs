//! Paths around what the cameras of a dataset look at.

use std::f64::consts::TAU;

use dpges_core::camera::{Camera, CameraFromWorld};
use glam::{DMat3, DQuat, DVec3};

use super::{CameraPath, PathError, pose};
use crate::percentile::percentiles;
use crate::up::Up;

const KEYS: usize = 24;
/// Cameras farther than so many times the median distance from the median of all are astray.
const ASTRAY: f64 = 20.0;

/// Where cameras stand and what they look at.
struct Surroundings {
    /// The point nearest to all viewing axes.
    focus: DVec3,
    up: DVec3,
    middle: DVec3,
    /// Mean distance of the centres from the focus.
    distance: f64,
}

impl Surroundings {
    fn new(cameras: &[Camera], up: Up) -> Self {
        let median = |values: Vec<f64>| percentiles(values, [0.5]).map_or(0.0, |[median]| median);
        let along = |axis: usize| median(cameras.iter().map(|camera| camera.centre()[axis]).collect());
        let amid = DVec3::new(along(0), along(1), along(2));
        let far = |camera: &Camera| (camera.centre() - amid).length();
        let farthest = ASTRAY * median(cameras.iter().map(far).collect());
        let cameras: Vec<&Camera> = cameras.iter().filter(|camera| far(camera) <= farthest).collect();
        let count = cameras.len() as f64;
        let axis = |camera: &Camera, row: usize| camera.camera_from_world.rotation.row(row);
        let middle = cameras.iter().map(|camera| camera.centre()).sum::<DVec3>() / count;
        // Σ (I − d dᵀ) (x − c) = 0, held at the mean distance along the axes where they are parallel
        let mut across = DMat3::ZERO;
        let mut right = DVec3::ZERO;
        for camera in &cameras {
            let forward = axis(camera, 2);
            let outer = DMat3::from_cols(forward * forward.x, forward * forward.y, forward * forward.z);
            let project = DMat3::IDENTITY - outer;
            across += project;
            right += project * camera.centre();
        }
        let spread = cameras.iter().map(|camera| (camera.centre() - middle).length()).sum::<f64>() / count;
        let ahead = middle + cameras.iter().map(|camera| axis(camera, 2)).sum::<DVec3>() / count * spread.max(1e-3);
        let slight = 1e-3 * count;
        let focus = (across + DMat3::from_diagonal(DVec3::splat(slight))).inverse() * (right + slight * ahead);
        let distance = cameras.iter().map(|camera| (camera.centre() - focus).length()).sum::<f64>() / count;
        Self { focus, up: up.direction(), middle, distance }
    }

    /// Two directions at right angles to up; the first points from the focus to the middle of the cameras.
    fn level(&self) -> [DVec3; 2] {
        let from_focus = self.middle - self.focus;
        let flat = from_focus - self.up * from_focus.dot(self.up);
        let first = flat.try_normalize().unwrap_or_else(|| self.up.any_orthonormal_vector());
        [first, self.up.cross(first)]
    }
}

fn looking(camera: &Camera, eye: DVec3, target: DVec3, up: DVec3) -> Camera {
    Camera { camera_from_world: CameraFromWorld::look_at(eye, target, up), ..*camera }
}

impl CameraPath {
    /// A level circle around what `cameras` look at, as far from it and as high as they are on average, with the lens and
    /// size of the first.
    ///
    /// # Errors
    /// [`PathError::Empty`] without cameras.
    pub fn orbit(cameras: &[Camera], up: Up) -> Result<Self, PathError> {
        let first = cameras.first().ok_or(PathError::Empty)?;
        let around = Surroundings::new(cameras, up);
        let [x, y] = around.level();
        let height = (around.middle - around.focus).dot(around.up).clamp(-0.9 * around.distance, 0.9 * around.distance);
        let radius = (around.distance * around.distance - height * height).sqrt();
        let key = |index: usize| {
            let (sine, cosine) = (index as f64 / KEYS as f64 * TAU).sin_cos();
            let eye = around.focus + radius * (x * cosine + y * sine) + height * around.up;
            looking(first, eye, around.focus, around.up)
        };
        Self::new((0..KEYS).map(key).collect(), true)
    }

    /// The first of `cameras`, turned by `angle` rad in `steps` equal steps about what they look at, and about what is
    /// `up`; `None` unless they look at one place: nine of ten have it in front of them.
    pub fn arc(cameras: &[Camera], up: Up, angle: f64, steps: usize) -> Option<Vec<Camera>> {
        let first = cameras.first()?;
        let around = Surroundings::new(cameras, up);
        let is_seen = |camera: &Camera| {
            let forward = camera.camera_from_world.rotation.row(2);
            (around.focus - camera.centre()).dot(forward) > 0.0
        };
        let turned = |step: usize| {
            let turn = DQuat::from_axis_angle(around.up, angle * step as f64 / steps as f64);
            let centre = around.focus + turn * (first.centre() - around.focus);
            let world_from_camera = turn * DQuat::from_mat3(&first.camera_from_world.rotation.transpose());
            Camera { camera_from_world: pose(centre, world_from_camera), ..*first }
        };
        let seeing = cameras.iter().filter(|camera| is_seen(camera)).count();
        (10 * seeing >= 9 * cameras.len()).then(|| (0..=steps).map(turned).collect())
    }

    /// Two small turns about the middle of `cameras`, nearer and further, with a look at what they look at: for scenes
    /// that face one way.
    ///
    /// # Errors
    /// [`PathError::Empty`] without cameras.
    pub fn spiral(cameras: &[Camera], up: Up) -> Result<Self, PathError> {
        let first = cameras.first().ok_or(PathError::Empty)?;
        let around = Surroundings::new(cameras, up);
        let forward = (around.focus - around.middle).try_normalize().unwrap_or(DVec3::X);
        let right = forward.cross(around.up).try_normalize().unwrap_or_else(|| forward.any_orthonormal_vector());
        let up = right.cross(forward);
        let radius = 0.15 * around.distance;
        let key = |index: usize| {
            let turn = 2.0 * index as f64 / (2 * KEYS) as f64 * TAU;
            let (sine, cosine) = turn.sin_cos();
            let eye = around.middle + radius * (right * cosine + up * sine + forward * (0.5 * turn).sin());
            looking(first, eye, around.focus, around.up)
        };
        Self::new((0..2 * KEYS).map(key).collect(), true)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures::camera;

    fn ring() -> Vec<Camera> {
        (0..12)
            .map(|i| {
                let (sine, cosine) = (f64::from(i) / 12.0 * TAU).sin_cos();
                camera([3.0 * cosine, 3.0 * sine, 1.0], 50.0)
            })
            .collect()
    }

    #[test]
    fn an_orbit_is_level_keeps_its_distance_and_looks_at_the_middle() {
        let mut cameras = ring();
        let astray = CameraFromWorld::look_at(DVec3::new(3e4, 0.0, 1.0), DVec3::Y, DVec3::X);
        cameras.push(Camera { camera_from_world: astray, ..cameras[0] });
        let path = CameraPath::orbit(&cameras, Up::Z).unwrap();
        for frame in path.frames(50) {
            let centre = frame.centre();
            assert!((centre.length() - 10f64.sqrt()).abs() < 0.01, "{centre}");
            assert!((centre.z - 1.0).abs() < 0.01, "{centre}");
            assert!(frame.camera_from_world.rotation.row(0).z.abs() < 1e-2, "it tilts");
            let (x, y, _) = frame.project(DVec3::ZERO).unwrap();
            assert!((x - 32.0).abs() < 0.2 && (y - 24.0).abs() < 0.2, "{x} {y}");
        }
    }

    #[test]
    fn an_arc_keeps_its_distance_from_what_is_looked_at() {
        let path = CameraPath::arc(&ring(), Up::Z, 0.1, 8).unwrap();
        assert_eq!(path.len(), 9);
        assert!((path[0].centre() - ring()[0].centre()).length() < 1e-9);
        for pair in path.windows(2) {
            let step = pair[0].centre().distance(pair[1].centre());
            assert!((step - 2.0 * 3.0 * (0.1f64 / 16.0).sin()).abs() < 1e-6, "{step}");
            let (x, y, depth) = pair[1].project(DVec3::ZERO).unwrap();
            let (x0, y0, depth0) = path[0].project(DVec3::ZERO).unwrap();
            assert!((x - x0).abs() < 1e-6 && (y - y0).abs() < 1e-6 && (depth - depth0).abs() < 1e-9);
        }
        let away = |camera: Camera| {
            let eye = camera.centre();
            Camera { camera_from_world: CameraFromWorld::look_at(eye, 2.0 * eye, DVec3::Z), ..camera }
        };
        assert!(CameraPath::arc(&ring().into_iter().map(away).collect::<Vec<_>>(), Up::Z, 0.1, 8).is_none());
    }

    #[test]
    fn a_spiral_stays_near_the_cameras_also_if_they_are_parallel() {
        let mut cameras = ring();
        cameras.truncate(1);
        cameras.push(Camera {
            camera_from_world: cameras[0].camera_from_world.recentred(DVec3::new(0.1, 0.0, 0.0)),
            ..cameras[0]
        });
        let path = CameraPath::spiral(&cameras, Up::Z).unwrap();
        for frame in path.frames(40) {
            assert!(frame.camera_from_world.translation.is_finite());
            assert!((frame.centre() - cameras[0].centre()).length() < 2.0);
        }
    }
}
