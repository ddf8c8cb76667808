//! The distortion of positions by a lens.

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

/// A lens: an undistorted position (a, b) = r (cos φ, sin φ) appears at (u, v) + shift, with
///
/// ```text
/// (u, v) = (a, b) (1 + Σ nᵢ r²ⁱ) / (1 + Σ dᵢ r²ⁱ)
/// shift = (2 p₁ a b + p₂ (r² + 2a²) + s₁ r² + t₁ r⁴,  p₁ (r² + 2b²) + 2 p₂ a b + s₂ r² + t₂ r⁴)
/// ```
///
/// or, [in sequence](Self::in_sequence), with the same shift of (u, v) in place of (a, b) and r² = u² + v².
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Distortion {
    pub projection: Projection,
    /// n₁..n₆: k₁, k₂, k₃ of OpenCV, k₁..k₄ of fisheye lenses, k₁..k₆ of `RAD_TAN_THIN_PRISM_FISHEYE`.
    pub numerator: [f64; 6],
    /// d₁..d₃: k₄, k₅, k₆ of `FULL_OPENCV`.
    pub denominator: [f64; 3],
    /// p₁, p₂.
    pub tangential: [f64; 2],
    /// s₁, s₂.
    pub thin_prism: [f64; 2],
    /// t₁, t₂ of `RAD_TAN_THIN_PRISM_FISHEYE`.
    pub thin_prism_quartic: [f64; 2],
    /// Whether what is tangential and the prisms move positions after the radius has changed
    /// (`RAD_TAN_THIN_PRISM_FISHEYE`), and not as if it had not.
    pub in_sequence: bool,
}

impl Distortion {
    /// None: a pinhole for [`Projection::Perspective`].
    pub fn new(projection: Projection) -> Self {
        Self {
            projection,
            numerator: [0.0; 6],
            denominator: [0.0; 3],
            tangential: [0.0; 2],
            thin_prism: [0.0; 2],
            thin_prism_quartic: [0.0; 2],
            in_sequence: false,
        }
    }

    /// Whether it is a pinhole.
    pub fn is_pinhole(&self) -> bool {
        let inert = Self { in_sequence: false, ..*self };
        inert == Self::new(Projection::Perspective)
    }

    /// Whether positions are moved across the radius.
    pub(super) fn is_radial(&self) -> bool {
        [self.tangential, self.thin_prism, self.thin_prism_quartic] == [[0.0; 2]; 3]
    }

    /// Factor of the radius at r² = `m`, and its first two derivatives with respect to m.
    pub(super) fn factor(&self, m: f64) -> [f64; 3] {
        let [n0, n1, n2] = polynomial(&self.numerator, m);
        let [d0, d1, d2] = polynomial(&self.denominator, m);
        let value = n0 / d0;
        let slope = (n1 - value * d1) / d0;
        [value, slope, (n2 - 2.0 * slope * d1 - value * d2) / d0]
    }

    /// Tangential and thin-prism shift of a position.
    fn shift(&self, u: f64, v: f64) -> [f64; 2] {
        let m = u * u + v * v;
        let ([p1, p2], [s1, s2], [t1, t2]) = (self.tangential, self.thin_prism, self.thin_prism_quartic);
        [
            2.0 * p1 * u * v + p2 * (m + 2.0 * u * u) + s1 * m + t1 * m * m,
            p1 * (m + 2.0 * v * v) + 2.0 * p2 * u * v + s2 * m + t2 * m * m,
        ]
    }

    /// Jacobian of [`shift`](Self::shift), by rows.
    fn shift_jacobian(&self, u: f64, v: f64) -> Mat2 {
        let m = u * u + v * v;
        let ([p1, p2], [s1, s2], [t1, t2]) = (self.tangential, self.thin_prism, self.thin_prism_quartic);
        [
            [
                2.0 * p1 * v + (6.0 * p2 + 2.0 * s1 + 4.0 * t1 * m) * u,
                2.0 * p1 * u + (2.0 * p2 + 2.0 * s1 + 4.0 * t1 * m) * v,
            ],
            [
                (2.0 * p1 + 2.0 * s2 + 4.0 * t2 * m) * u + 2.0 * p2 * v,
                (6.0 * p1 + 2.0 * s2 + 4.0 * t2 * m) * v + 2.0 * p2 * u,
            ],
        ]
    }

    /// Gradient with respect to (u, v) from that with respect to [`shift_jacobian`](Self::shift_jacobian).
    fn shift_jacobian_backward(&self, u: f64, v: f64, [[xx, xy], [yx, yy]]: Mat2) -> [f64; 2] {
        let ([p1, p2], [s1, s2], [t1, t2]) = (self.tangential, self.thin_prism, self.thin_prism_quartic);
        let m = u * u + v * v;
        // of 4 m (along u + across v)
        let (along, across) = (xx * t1 + yx * t2, xy * t1 + yy * t2);
        let form = 8.0 * (along * u + across * v);
        [
            xx * (6.0 * p2 + 2.0 * s1)
                + xy * 2.0 * p1
                + yx * (2.0 * p1 + 2.0 * s2)
                + yy * 2.0 * p2
                + 4.0 * m * along
                + form * u,
            xx * 2.0 * p1
                + xy * (2.0 * p2 + 2.0 * s1)
                + yx * 2.0 * p2
                + yy * (6.0 * p1 + 2.0 * s2)
                + 4.0 * m * across
                + form * v,
        ]
    }

    /// The position at which the shift is evaluated, for an undistorted position whose radius has this factor.
    fn shifted(&self, a: f64, b: f64, factor: f64) -> [f64; 2] {
        if self.in_sequence { [a * factor, b * factor] } else { [a, b] }
    }

    /// Position of an undistorted position.
    pub fn apply(&self, a: f64, b: f64) -> [f64; 2] {
        let [factor, ..] = self.factor(a * a + b * b);
        let [u, v] = self.shifted(a, b, factor);
        let [x, y] = self.shift(u, v);
        [a * factor + x, b * factor + y]
    }

    /// Jacobian of [`apply`](Self::apply), by rows.
    pub(super) fn jacobian(&self, a: f64, b: f64) -> Mat2 {
        let factor = self.factor(a * a + b * b);
        let radial = radial_jacobian(a, b, factor);
        let [u, v] = self.shifted(a, b, factor[0]);
        let shift = self.shift_jacobian(u, v);
        sum(radial, if self.in_sequence { product(shift, radial) } else { shift })
    }

    /// Gradient with respect to (a, b) from that with respect to the Jacobian.
    pub(super) fn jacobian_backward(&self, a: f64, b: f64, grad: Mat2) -> [f64; 2] {
        let factor = self.factor(a * a + b * b);
        let [u, v] = self.shifted(a, b, factor[0]);
        if !self.in_sequence {
            let [x, y] = radial_jacobian_backward(a, b, factor, grad);
            let [shift_x, shift_y] = self.shift_jacobian_backward(u, v, grad);
            return [x + shift_x, y + shift_y];
        }
        // J = (1 + S(u, v)) R(a, b), and R is symmetric
        let radial = radial_jacobian(a, b, factor);
        let grad_radial = sum(grad, product(transposed(self.shift_jacobian(u, v)), grad));
        let [x, y] = radial_jacobian_backward(a, b, factor, grad_radial);
        let [grad_u, grad_v] = self.shift_jacobian_backward(u, v, product(grad, radial));
        [x + radial[0][0] * grad_u + radial[1][0] * grad_v, y + radial[0][1] * grad_u + radial[1][1] * grad_v]
    }
}

/// By rows.
type Mat2 = [[f64; 2]; 2];

fn sum(a: Mat2, b: Mat2) -> Mat2 {
    [0, 1].map(|i| [0, 1].map(|k| a[i][k] + b[i][k]))
}

fn product(a: Mat2, b: Mat2) -> Mat2 {
    [0, 1].map(|i| [0, 1].map(|k| a[i][0] * b[0][k] + a[i][1] * b[1][k]))
}

/// Jacobian of a position times its factor alone, by rows.
fn radial_jacobian(a: f64, b: f64, [value, slope, _]: [f64; 3]) -> Mat2 {
    let across = 2.0 * a * b * slope;
    [[value + 2.0 * a * a * slope, across], [across, value + 2.0 * b * b * slope]]
}

/// Gradient with respect to (a, b) from that with respect to [`radial_jacobian`].
fn radial_jacobian_backward(a: f64, b: f64, [_, slope, bend]: [f64; 3], [[xx, xy], [yx, yy]]: Mat2) -> [f64; 2] {
    let mixed = xy + yx;
    // of slope · (xx 2a² + mixed 2ab + yy 2b²) + value · (xx + yy)
    let form = 2.0 * (xx * a * a + mixed * a * b + yy * b * b);
    let common = 2.0 * (slope * (xx + yy) + bend * form);
    [a * common + slope * (4.0 * xx * a + 2.0 * mixed * b), b * common + slope * (4.0 * yy * b + 2.0 * mixed * a)]
}

fn transposed([[xx, xy], [yx, yy]]: Mat2) -> Mat2 {
    [[xx, yx], [xy, yy]]
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
