//! Intrinsics of a photograph as taken, including lens distortion.

use dpges_core::camera::{Camera, CameraFromWorld};

/// Radial and tangential distortion in the convention of OpenCV and COLMAP: a point at (x, y) on the plane
/// z = 1 appears at
/// `(x, y) · (1 + Σ aᵢ r²ⁱ) / (1 + Σ bᵢ r²ⁱ) + (2 p₁ x y + p₂ (r² + 2x²), p₁ (r² + 2y²) + 2 p₂ x y)`,
/// with r² = x² + y².
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Distortion {
    /// a₁..a₄: k₁, k₂, k₃ and nerfstudio's k₄.
    pub numerator: [f64; 4],
    /// b₁..b₃: k₄, k₅, k₆ of FULL_OPENCV.
    pub denominator: [f64; 3],
    /// p₁, p₂.
    pub tangential: [f64; 2],
}

impl Distortion {
    pub fn is_zero(&self) -> bool {
        *self == Self::default()
    }

    pub fn apply(&self, x: f64, y: f64) -> (f64, f64) {
        let r2 = x * x + y * y;
        let polynomial = |coefficients: &[f64]| 1.0 + coefficients.iter().rev().fold(0.0, |sum, c| (sum + c) * r2);
        let radial = polynomial(&self.numerator) / polynomial(&self.denominator);
        let [p1, p2] = self.tangential;
        (
            x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
            y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
        )
    }
}

/// Size, focal lengths and principal point in px (centre of the first pixel at 0.5), and distortion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Lens {
    pub width: usize,
    pub height: usize,
    pub fx: f64,
    pub fy: f64,
    pub cx: f64,
    pub cy: f64,
    pub distortion: Distortion,
}

impl Lens {
    /// The pinhole camera with these intrinsics, without distortion; see [`super::undistort`].
    pub fn camera(&self, camera_from_world: CameraFromWorld, near: f64) -> Camera {
        let Self { width, height, fx, fy, cx, cy, .. } = *self;
        Camera { camera_from_world, fx, fy, cx, cy, width, height, near, lens: None }
    }

    /// The same lens for the photograph resized to `width` × `height` px.
    pub fn resized(&self, width: usize, height: usize) -> Self {
        let (sx, sy) = (width as f64 / self.width as f64, height as f64 / self.height as f64);
        Self { width, height, fx: self.fx * sx, fy: self.fy * sy, cx: self.cx * sx, cy: self.cy * sy, ..*self }
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
    use super::*;

    fn lens(width: usize, height: usize) -> Lens {
        Lens { width, height, fx: 800.0, fy: 810.0, cx: 400.0, cy: 290.0, distortion: Distortion::default() }
    }

    #[test]
    fn resizing_may_round_but_not_crop() {
        let lens = lens(1237, 822);
        for (width, height) in [(1237, 822), (618, 411), (619, 411), (309, 205), (310, 206), (155, 103)] {
            assert!(lens.fits(width, height), "{width}x{height}");
        }
        for (width, height) in [(822, 1237), (618, 400), (1237, 800)] {
            assert!(!lens.fits(width, height), "{width}x{height}");
        }
    }

    #[test]
    fn distortion_follows_the_opencv_formula() {
        let distortion = Distortion {
            numerator: [0.1, -0.02, 0.003, 0.0],
            denominator: [0.01, 0.0, 0.0],
            tangential: [0.004, -0.005],
        };
        let (x, y) = distortion.apply(0.5, -0.25);
        let r2 = 0.3125f64;
        let radial = (1.0 + 0.1 * r2 - 0.02 * r2.powi(2) + 0.003 * r2.powi(3)) / (1.0 + 0.01 * r2);
        assert!((x - (0.5 * radial + 2.0 * 0.004 * 0.5 * -0.25 - 0.005 * (r2 + 0.5))).abs() < 1e-15);
        assert!((y - (-0.25 * radial + 0.004 * (r2 + 0.125) - 2.0 * 0.005 * 0.5 * -0.25)).abs() < 1e-15);
        assert_eq!(Distortion::default().apply(0.3, 0.4), (0.3, 0.4));
    }
}
