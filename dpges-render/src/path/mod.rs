//! Camera paths: key cameras, and what lies between them.

mod extent;
mod json;
mod shapes;
mod size;

use dpges_core::camera::{Camera, CameraFromWorld};
use glam::{DMat3, DQuat, DVec3};

pub use extent::Extent;
pub use json::{NamedCamera, PathError, cameras_from_json, in_scene, load_cameras, to_json};
pub use size::Size;

/// A smooth way through key cameras: Catmull–Rom splines through their centres, the shortest turns between their
/// rotations, straight lines between their focal lengths and principal points.
#[derive(Clone, Debug, PartialEq)]
pub struct CameraPath {
    keys: Vec<Camera>,
    closed: bool,
}

impl CameraPath {
    /// A way through `keys`, in the coordinates of the scene; `closed` ones return from the last to the first.
    ///
    /// # Errors
    /// [`PathError::Empty`] without keys.
    pub fn new(keys: Vec<Camera>, closed: bool) -> Result<Self, PathError> {
        if keys.is_empty() { Err(PathError::Empty) } else { Ok(Self { keys, closed }) }
    }

    pub fn keys(&self) -> &[Camera] {
        &self.keys
    }

    fn segments(&self) -> usize {
        if self.closed { self.keys.len() } else { self.keys.len() - 1 }
    }

    /// The camera at `time`, 0 at the first key and 1 at the end of the path, with the picture size of the first key.
    pub fn at(&self, time: f64) -> Camera {
        let count = self.keys.len();
        let position = time.clamp(0.0, 1.0) * self.segments() as f64;
        let segment = (position as usize).min(self.segments().saturating_sub(1));
        let share = position - segment as f64;
        let key = |offset: isize| {
            let index = segment as isize + offset;
            let index = if self.closed { index.rem_euclid(count as isize) } else { index.clamp(0, count as isize - 1) };
            &self.keys[index as usize]
        };
        let centre = catmull_rom([-1, 0, 1, 2].map(|offset| key(offset).centre()), share);
        let world_from_camera = turn(key(0)).slerp(turn(key(1)), share);
        let between = |a: f64, b: f64| a + share * (b - a);
        let first = &self.keys[0];
        // keys may differ in size: their lenses are compared at that of the first
        let [a, b] = [key(0), key(1)].map(|camera| camera.resized(first.width, first.height));
        Camera {
            camera_from_world: pose(centre, world_from_camera),
            fx: between(a.fx, b.fx),
            fy: between(a.fy, b.fy),
            cx: between(a.cx, b.cx),
            cy: between(a.cy, b.cy),
            near: between(a.near, b.near),
            ..*first
        }
    }

    /// `count` cameras at equal steps of time; those of a closed path do not repeat the first.
    pub fn frames(&self, count: usize) -> Vec<Camera> {
        let steps = if self.closed { count } else { count.saturating_sub(1) };
        (0..count).map(|frame| self.at(frame as f64 / steps.max(1) as f64)).collect()
    }
}

fn turn(camera: &Camera) -> DQuat {
    DQuat::from_mat3(&camera.camera_from_world.rotation.transpose())
}

/// The pose of a camera at `centre` with axes turned by `world_from_camera`.
pub(crate) fn pose(centre: DVec3, world_from_camera: DQuat) -> CameraFromWorld {
    let rotation = DMat3::from_quat(world_from_camera.normalize()).transpose();
    CameraFromWorld { rotation, translation: -(rotation * centre) }
}

/// The uniform Catmull–Rom spline from the second point to the third.
fn catmull_rom([before, from, to, after]: [DVec3; 4], t: f64) -> DVec3 {
    let linear = to - before;
    let square = 2.0 * before - 5.0 * from + 4.0 * to - after;
    let cube = 3.0 * (from - to) + after - before;
    from + 0.5 * t * (linear + t * (square + t * cube))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures::camera;

    fn keys() -> Vec<Camera> {
        vec![camera([4.0, 0.0, 1.0], 50.0), camera([0.0, 4.0, 1.0], 60.0), camera([-4.0, 0.5, 2.0], 50.0)]
    }

    #[test]
    fn a_path_goes_through_its_keys() {
        for closed in [false, true] {
            let path = CameraPath::new(keys(), closed).unwrap();
            for (index, key) in keys().iter().enumerate() {
                let found = path.at(index as f64 / path.segments() as f64);
                assert!((found.centre() - key.centre()).length() < 1e-9);
                assert!((found.fx - key.fx).abs() < 1e-9);
                let turned = found.camera_from_world.rotation * key.camera_from_world.rotation.transpose();
                assert!((turned - DMat3::IDENTITY).abs_diff_eq(DMat3::ZERO, 1e-9));
            }
        }
    }

    #[test]
    fn steps_are_small_and_a_closed_path_returns() {
        let path = CameraPath::new(keys(), true).unwrap();
        let frames = path.frames(90);
        assert_eq!(frames.len(), 90);
        let steps = frames.iter().zip(frames.iter().cycle().skip(1));
        assert!(steps.map(|(a, b)| (a.centre() - b.centre()).length()).all(|step| step > 0.0 && step < 0.5));
        let open = CameraPath::new(keys(), false).unwrap().frames(10);
        assert!((open[9].centre() - keys()[2].centre()).length() < 1e-9);
    }

    #[test]
    fn one_key_is_a_path_that_stays() {
        let path = CameraPath::new(vec![camera([1.0, 2.0, 3.0], 40.0)], false).unwrap();
        assert!(path.frames(3).iter().all(|frame| (frame.centre() - path.keys()[0].centre()).length() < 1e-12));
        assert!(matches!(CameraPath::new(Vec::new(), false), Err(PathError::Empty)));
    }
}
