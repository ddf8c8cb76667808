//! Sizes of pictures.

use std::str::FromStr;

use dpges_core::camera::Camera;

/// Width and height, px.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Size {
    pub width: usize,
    pub height: usize,
}

/// Most pixels of a picture: what it takes to draw it is a few hundred times as many bytes.
const MOST_PX: usize = 1 << 27;

impl FromStr for Size {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let parse = |side: &str| side.parse::<usize>().ok().filter(|&side| side > 0);
        text.split_once('x')
            .and_then(|(width, height)| Some(Self { width: parse(width)?, height: parse(height)? }))
            .ok_or_else(|| format!("`{text}` is no size: write WIDTHxHEIGHT in px, as in 1920x1080"))
            .and_then(|size| {
                let is_drawable = size.width.checked_mul(size.height).is_some_and(|area| area <= MOST_PX);
                let most = MOST_PX >> 20;
                is_drawable
                    .then_some(size)
                    .ok_or_else(|| format!("{text} are more than {most} million pixels: draw parts"))
            })
    }
}

impl Size {
    /// `camera` with a picture of this size: the vertical field of view stays, and the principal point keeps its offset
    /// from the middle.
    pub fn apply(self, camera: &Camera) -> Camera {
        let scale = self.height as f64 / camera.height as f64;
        let moved = |centre: f64, old: usize, new: usize| (centre - 0.5 * old as f64) * scale + 0.5 * new as f64;
        Camera {
            fx: camera.fx * scale,
            fy: camera.fy * scale,
            cx: moved(camera.cx, camera.width, self.width),
            cy: moved(camera.cy, camera.height, self.height),
            width: self.width,
            height: self.height,
            ..*camera
        }
    }
}

#[cfg(test)]
mod tests {
    use dpges_core::camera::CameraFromWorld;
    use glam::{DMat3, DVec3};

    use super::*;
    use crate::fixtures::pinhole;

    #[test]
    fn sizes_are_read_and_wrong_ones_explained() {
        assert_eq!("1920x1080".parse(), Ok(Size { width: 1920, height: 1080 }));
        for text in ["1920", "0x4", "4x", "axb", "4x-1"] {
            assert!(text.parse::<Size>().unwrap_err().contains("1920x1080"), "{text}");
        }
        assert!("16384x8192".parse::<Size>().is_ok());
        for text in ["100000x100000", "18446744073709551615x2"] {
            assert!(text.parse::<Size>().unwrap_err().contains("128 million pixels"), "{text}");
        }
    }

    #[test]
    fn another_size_keeps_the_vertical_field_of_view_and_what_is_in_the_middle() {
        let camera_from_world = CameraFromWorld { rotation: DMat3::IDENTITY, translation: DVec3::ZERO };
        let camera = Camera { fy: 60.0, cx: 22.0, cy: 9.0, ..pinhole(camera_from_world, 50.0, [40, 20]) };
        let wide = Size { width: 160, height: 40 }.apply(&camera);
        assert_eq!((wide.fx, wide.fy, wide.width, wide.height), (100.0, 120.0, 160, 40));
        assert_eq!((wide.cx, wide.cy), (84.0, 18.0));
    }
}
