//! Which way is up in a scene. 3DGS writes the axes of the dataset as they are; SPZ and glTF say that y is up.

use std::fmt;
use std::str::FromStr;

use dpges_core::camera::Camera;
use dpges_core::scene::SceneInfo;
use glam::{DMat3, DQuat, DVec3};

/// Cosine of the angle within which a direction is meant to be an axis: people level their worlds, cameras less exactly.
const NEARLY_AN_AXIS: f64 = 0.9962;
/// Cameras whose upward directions add up to less, per camera, have none in common.
const LEAST_COMMON_UP: f64 = 0.2;
const STEPS: usize = 200;

/// Unit vector of a scene that points up.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Up(DVec3);

impl Up {
    /// As cameras with OpenCV axes have it: roughly what COLMAP makes of upright photographs, and what readers of splats in
    /// PLY files expect.
    pub const MINUS_Y: Self = Self(DVec3::NEG_Y);
    /// Up in files that are already in the axes of glTF.
    pub const Y: Self = Self(DVec3::Y);
    /// Up in Blender, nerfstudio, and the built-in scene.
    pub const Z: Self = Self(DVec3::Z);

    /// `None` if `direction` is none.
    pub fn new(direction: DVec3) -> Option<Self> {
        direction.try_normalize().map(Self)
    }

    /// That of a scene; −y if it does not say.
    pub fn of(info: &SceneInfo) -> Self {
        info.up.and_then(|up| Self::new(up.into())).unwrap_or(Self::MINUS_Y)
    }

    /// Upwards, as most of `cameras` are held: the direction that is most nearly at right angles to what is to the right of
    /// each, since people hold cameras level however far they look up or down; an axis that it nearly is. `None` if they
    /// agree on nothing.
    pub fn of_cameras<'a>(cameras: impl Iterator<Item = &'a Camera>) -> Option<Self> {
        let axes = |camera: &Camera| [0, 1].map(|row| camera.camera_from_world.rotation.row(row));
        let axes: Vec<[DVec3; 2]> = cameras.map(axes).collect();
        let count = axes.len() as f64;
        let sum = -axes.iter().map(|[_, down]| down).sum::<DVec3>();
        if sum.length() <= LEAST_COMMON_UP * count {
            return None;
        }
        // power iteration: takes away, again and again, the parts along the directions to the right
        let up = (0..STEPS).fold(sum.normalize(), |up, _| {
            let along = axes.iter().map(|[right, _]| right.dot(up) * right).sum::<DVec3>();
            (count * up - along).normalize_or(up)
        });
        let axis = DVec3::AXES[up.abs().max_position()] * up[up.abs().max_position()].signum();
        Some(Self(if axis.dot(up) > NEARLY_AN_AXIS { axis } else { up }))
    }

    pub fn direction(self) -> DVec3 {
        self.0
    }

    /// Rotation that turns the scene upright in axes with x right, y up, z towards the viewer (RUB): those of SPZ. From −y by
    /// half a turn about x, from z by a quarter.
    pub fn to_rub(self) -> DMat3 {
        self.to_y(DVec3::new(1.0, -1.0, -1.0))
    }

    /// Rotation to the axes of glTF: y up, z where the front looks. The front of a camera with OpenCV axes, +z, stays
    /// there, and Blender's front, −y, becomes +z, as their own converters have it.
    pub fn to_gltf(self) -> DMat3 {
        self.to_y(DVec3::new(-1.0, -1.0, 1.0))
    }

    /// The shortest way to y; where that is nearly a half turn, the shortest to −y and then `half_turn`.
    fn to_y(self, half_turn: DVec3) -> DMat3 {
        let is_down = self.0.y < -std::f64::consts::FRAC_1_SQRT_2;
        let (target, then) = if is_down { (DVec3::NEG_Y, half_turn) } else { (DVec3::Y, DVec3::ONE) };
        let turn = DMat3::from_diagonal(then) * DMat3::from_quat(DQuat::from_rotation_arc(self.0, target));
        // axes go to axes exactly
        let exact = |entry: f64| if (entry - entry.round()).abs() < 1e-9 { entry.round() } else { entry };
        DMat3::from_cols_array(&turn.to_cols_array().map(exact))
    }
}

impl fmt::Display for Up {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let DVec3 { x, y, z } = self.0;
        let at = self.0.abs().max_position();
        match self.0[at].abs() == 1.0 {
            true => write!(f, "{}{}", if self.0[at] < 0.0 { "-" } else { "" }, ["x", "y", "z"][at]),
            false => write!(f, "{x:.4},{y:.4},{z:.4}"),
        }
    }
}

impl FromStr for Up {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wrong = || format!("`{text}` is no direction: use x, y, z, -x, -y, -z, or three numbers such as 0,-1,0.2");
        let (sign, axis) = text.strip_prefix('-').map_or((1.0, text), |axis| (-1.0, axis));
        let direction = match ["x", "y", "z"].iter().position(|name| *name == axis) {
            Some(at) => sign * DVec3::AXES[at],
            None => {
                let numbers: Result<Vec<f64>, _> = text.split(',').map(|number| number.trim().parse()).collect();
                let numbers = numbers.map_err(|_| wrong())?;
                DVec3::from_array(numbers.try_into().map_err(|_| wrong())?)
            }
        };
        Self::new(direction).ok_or_else(wrong)
    }
}

#[cfg(test)]
mod tests {
    use dpges_core::camera::CameraFromWorld;
    use glam::dvec3;

    use super::*;
    use crate::fixtures::pinhole;

    #[test]
    fn up_becomes_y_without_mirroring() {
        for direction in ["-y", "y", "z", "x", "-x", "-z", "0.1,-0.9,0.3", "0,0.7,0.8"] {
            let up: Up = direction.parse().unwrap();
            for rotation in [up.to_rub(), up.to_gltf()] {
                assert!((rotation * up.direction() - DVec3::Y).length() < 1e-9, "{direction}");
                assert!((rotation.determinant() - 1.0).abs() < 1e-9);
            }
        }
        // as converters of those programs turn
        assert_eq!(Up::MINUS_Y.to_rub() * dvec3(1.0, 2.0, 3.0), dvec3(1.0, -2.0, -3.0));
        assert_eq!(Up::MINUS_Y.to_gltf() * dvec3(1.0, 2.0, 3.0), dvec3(-1.0, -2.0, 3.0));
        assert_eq!(Up::Z.to_gltf() * dvec3(1.0, 2.0, 3.0), dvec3(1.0, 3.0, -2.0));
    }

    #[test]
    fn directions_read_what_they_write_and_others_are_explained() {
        for text in ["x", "-y", "z", "0.0000,-0.6000,0.8000"] {
            assert_eq!(text.parse::<Up>().unwrap().to_string(), text);
        }
        for text in ["", "up", "1,2", "0,0,0", "nan,0,0"] {
            assert!(text.parse::<Up>().unwrap_err().contains("-y"), "{text}");
        }
    }

    #[test]
    fn up_is_what_cameras_agree_on() {
        let held = |eye: DVec3, up| pinhole(CameraFromWorld::look_at(eye, DVec3::ZERO, up), 10.0, [10, 10]);
        let from_above = [dvec3(1.0, 0.1, 0.9), dvec3(0.8, 0.6, 1.2), dvec3(0.0, 1.0, 0.7)];
        let of = |up: DVec3| Up::of_cameras(from_above.map(|eye| held(eye, up)).iter());
        assert_eq!(of(DVec3::Z), Some(Up::Z));
        assert_eq!(of(dvec3(0.02, 0.0, 1.0)), Some(Up::Z));
        let oblique = dvec3(0.3, 0.0, 1.0).normalize();
        assert!(of(oblique).unwrap().direction().dot(oblique) > 0.9999);
        let alone = held(from_above[0], DVec3::Z);
        let down = alone.camera_from_world.rotation.row(1);
        assert!(Up::of_cameras([alone].iter()).unwrap().direction().dot(-down) > 0.9999);
        let odds = [held(DVec3::X, DVec3::Z), held(DVec3::X, DVec3::NEG_Z)];
        assert_eq!((Up::of_cameras(odds.iter()), Up::of_cameras([].iter())), (None, None));
    }
}
