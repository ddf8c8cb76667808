//! Intrinsics of a photograph as taken.

use dpges_core::camera::{Camera, CameraFromWorld, Distortion, Lens};

/// Size, focal lengths and principal point in px (centre of the first pixel at 0.5), and what the lens does.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in crate::dataset) struct Calibration {
    pub width: usize,
    pub height: usize,
    pub fx: f64,
    pub fy: f64,
    pub cx: f64,
    pub cy: f64,
    pub distortion: Distortion,
}

impl Calibration {
    /// The camera that took the photograph.
    pub fn camera(&self, camera_from_world: CameraFromWorld, near: f64) -> Camera {
        let Self { width, height, fx, fy, cx, cy, distortion } = *self;
        let lens = (!distortion.is_pinhole()).then(|| Lens::new(distortion));
        Camera { camera_from_world, fx, fy, cx, cy, width, height, near, lens }
    }

    /// Whether an image of `width` × `height` px is the whole photograph resized, each side rounded by up to a pixel.
    pub fn fits(&self, width: usize, height: usize) -> bool {
        let scales =
            |found: usize, full: usize| ((found as f64 - 1.0) / full as f64, (found as f64 + 1.0) / full as f64);
        let (low_x, high_x) = scales(width, self.width);
        let (low_y, high_y) = scales(height, self.height);
        (width, height) == (self.width, self.height) || low_x.max(low_y) < high_x.min(high_y)
    }
}

#[cfg(test)]
mod tests {
    use dpges_core::camera::Projection;
    use glam::DVec3;

    use super::*;

    fn calibration(projection: Projection) -> Calibration {
        let distortion = Distortion::new(projection);
        Calibration { width: 1237, height: 822, fx: 800.0, fy: 810.0, cx: 400.0, cy: 290.0, distortion }
    }

    #[test]
    fn resizing_may_round_but_not_crop() {
        let calibration = calibration(Projection::Perspective);
        for (width, height) in [(1237, 822), (618, 411), (619, 411), (309, 205), (310, 206), (155, 103)] {
            assert!(calibration.fits(width, height), "{width}x{height}");
        }
        for (width, height) in [(822, 1237), (618, 400), (1237, 800)] {
            assert!(!calibration.fits(width, height), "{width}x{height}");
        }
    }

    #[test]
    fn only_what_bends_rays_is_a_lens() {
        let pose = CameraFromWorld::look_at(DVec3::ONE, DVec3::ZERO, DVec3::Z);
        assert!(calibration(Projection::Perspective).camera(pose, 0.1).lens.is_none());
        let fisheye = calibration(Projection::Equidistant).camera(pose, 0.1);
        assert!(fisheye.lens.is_some_and(|lens| lens.is_wide()));
        assert_eq!((fisheye.fx, fisheye.cy, fisheye.width), (800.0, 290.0, 1237));
    }
}
