//! What a lens does to positions on the picture.

use serde::{Deserialize, Serialize};

/// How the undistorted radius r grows with the angle θ from the optical axis.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Projection {
    /// r = tan θ. Depth is camera-space z.
    Perspective,
    /// r = θ: fisheye. Depth is the distance from the camera's centre.
    Equidistant,
    /// r = atan(2 tan θ tan(ω/2)) / ω (Devernay and Faugeras, 2001), ω in (0, π) radians. Depth is the distance from the
    /// camera's centre.
    FieldOfView(f64),
}

/// A lens: an undistorted position (a, b) = r (cos φ, sin φ) appears at
/// `(a, b) (1 + Σ nᵢ r²ⁱ) / (1 + Σ dᵢ r²ⁱ) + (2 p₁ a b + p₂ (r² + 2a²) + s₁ r², p₁ (r² + 2b²) + 2 p₂ a b + s₂ r²)`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Distortion {
    pub projection: Projection,
    /// n₁..n₄: k₁, k₂, k₃ of OpenCV, k₁..k₄ of fisheye lenses.
    pub numerator: [f64; 4],
    /// d₁..d₃: k₄, k₅, k₆ of `FULL_OPENCV`.
    pub denominator: [f64; 3],
    /// p₁, p₂.
    pub tangential: [f64; 2],
    /// s₁, s₂.
    pub thin_prism: [f64; 2],
}

impl Distortion {
    /// None: a pinhole for [`Projection::Perspective`].
    pub fn new(projection: Projection) -> Self {
        Self { projection, numerator: [0.0; 4], denominator: [0.0; 3], tangential: [0.0; 2], thin_prism: [0.0; 2] }
    }

    /// Whether it is a pinhole.
    pub fn is_pinhole(&self) -> bool {
        *self == Self::new(Projection::Perspective)
    }

    /// Whether positions are moved across the radius.
    pub(super) fn is_radial(&self) -> bool {
        self.tangential == [0.0; 2] && self.thin_prism == [0.0; 2]
    }

    /// Factor of the radius at r² = `m`, and its first two derivatives with respect to m.
    pub(super) fn factor(&self, m: f64) -> [f64; 3] {
        let [n0, n1, n2] = polynomial(&self.numerator, m);
        let [d0, d1, d2] = polynomial(&self.denominator, m);
        let value = n0 / d0;
        let slope = (n1 - value * d1) / d0;
        [value, slope, (n2 - 2.0 * slope * d1 - value * d2) / d0]
    }

    /// Position of an undistorted position.
    pub fn apply(&self, a: f64, b: f64) -> [f64; 2] {
        let m = a * a + b * b;
        let [radial, ..] = self.factor(m);
        let ([p1, p2], [s1, s2]) = (self.tangential, self.thin_prism);
        [
            a * radial + 2.0 * p1 * a * b + p2 * (m + 2.0 * a * a) + s1 * m,
            b * radial + p1 * (m + 2.0 * b * b) + 2.0 * p2 * a * b + s2 * m,
        ]
    }

    /// Jacobian of [`apply`](Self::apply), by rows.
    pub(super) fn jacobian(&self, a: f64, b: f64) -> [[f64; 2]; 2] {
        let [value, slope, _] = self.factor(a * a + b * b);
        let ([p1, p2], [s1, s2]) = (self.tangential, self.thin_prism);
        let across = 2.0 * a * b * slope;
        [
            [
                value + 2.0 * a * a * slope + 2.0 * p1 * b + (6.0 * p2 + 2.0 * s1) * a,
                across + 2.0 * p1 * a + (2.0 * p2 + 2.0 * s1) * b,
            ],
            [
                across + (2.0 * p1 + 2.0 * s2) * a + 2.0 * p2 * b,
                value + 2.0 * b * b * slope + (6.0 * p1 + 2.0 * s2) * b + 2.0 * p2 * a,
            ],
        ]
    }

    /// Gradient with respect to (a, b) from that with respect to the Jacobian.
    pub(super) fn jacobian_backward(&self, a: f64, b: f64, grad: [[f64; 2]; 2]) -> [f64; 2] {
        let [_, slope, bend] = self.factor(a * a + b * b);
        let ([p1, p2], [s1, s2]) = (self.tangential, self.thin_prism);
        let [[xx, xy], [yx, yy]] = grad;
        let mixed = xy + yx;
        // of slope · (xx 2a² + mixed 2ab + yy 2b²) + value · (xx + yy)
        let form = 2.0 * (xx * a * a + mixed * a * b + yy * b * b);
        let common = 2.0 * (slope * (xx + yy) + bend * form);
        [
            a * common
                + slope * (4.0 * xx * a + 2.0 * mixed * b)
                + xx * (6.0 * p2 + 2.0 * s1)
                + xy * 2.0 * p1
                + yx * (2.0 * p1 + 2.0 * s2)
                + yy * 2.0 * p2,
            b * common
                + slope * (4.0 * yy * b + 2.0 * mixed * a)
                + xx * 2.0 * p1
                + xy * (2.0 * p2 + 2.0 * s1)
                + yx * 2.0 * p2
                + yy * (6.0 * p1 + 2.0 * s2),
        ]
    }
}

/// `1 + Σ cᵢ mⁱ` and its first two derivatives.
fn polynomial(coefficients: &[f64], m: f64) -> [f64; 3] {
    let [mut value, mut slope, mut bend] = [0.0; 3];
    for (i, c) in coefficients.iter().enumerate().rev() {
        let power = (i + 1) as f64;
        value = (value + c) * m;
        slope = slope * m + power * c;
        if i > 0 {
            bend = bend * m + power * (power - 1.0) * c;
        }
    }
    [1.0 + value, slope, bend]
}
