//! Which way is up. 3DGS writes the axes of the dataset as they are; SPZ and glTF say that y is up.

use std::fmt;

use glam::{DMat3, DVec3};

/// Axis of the scene that points up.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum UpAxis {
    /// −y, as cameras with OpenCV axes have it: roughly what COLMAP makes of upright photographs, and what readers of
    /// splats in PLY files expect.
    #[default]
    MinusY,
    /// Up in files that are already in the axes of glTF.
    Y,
    /// Up in Blender, nerfstudio, and the built-in scene.
    Z,
}

impl UpAxis {
    /// Rotation that turns the scene upright in axes with x right, y up, z towards the viewer (RUB): those of SPZ. By
    /// half a turn or a quarter about x.
    pub fn to_rub(self) -> DMat3 {
        match self {
            Self::MinusY => DMat3::from_cols(DVec3::X, -DVec3::Y, -DVec3::Z),
            Self::Y => DMat3::IDENTITY,
            Self::Z => DMat3::from_cols(DVec3::X, -DVec3::Z, DVec3::Y),
        }
    }

    /// Rotation to the axes of glTF: y up, z where the front looks. The front of a camera with OpenCV axes, +z, stays
    /// there, and Blender's front, −y, becomes +z, as their own converters have it.
    pub fn to_gltf(self) -> DMat3 {
        match self {
            Self::MinusY => DMat3::from_cols(-DVec3::X, -DVec3::Y, DVec3::Z),
            Self::Y | Self::Z => self.to_rub(),
        }
    }
}

impl fmt::Display for UpAxis {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::MinusY => "-y",
            Self::Y => "y",
            Self::Z => "z",
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn up_becomes_y_without_mirroring() {
        for (up, direction) in [(UpAxis::MinusY, -DVec3::Y), (UpAxis::Y, DVec3::Y), (UpAxis::Z, DVec3::Z)] {
            for rotation in [up.to_rub(), up.to_gltf()] {
                assert_eq!(rotation * direction, DVec3::Y);
                assert_eq!(rotation.determinant(), 1.0);
            }
        }
    }
}
