//! Lenses that a pinhole camera does not describe: from a direction to a position on the picture and back, and the
//! derivatives that a Gaussian seen through them needs.
//!
//! The models are those of COLMAP (`src/colmap/sensor/models.h`). Positions are in focal lengths from the principal point,
//! directions in camera axes, angles in radians.

mod distortion;
#[cfg(test)]
mod tests;

use std::f64::consts::FRAC_PI_2;

use serde::{Deserialize, Serialize};

pub use distortion::{Distortion, Projection};

/// Largest angle from the optical axis that a lens sees. Behind the camera, next to the axis, a fisheye would stretch what
/// it sees without bound.
const WIDEST_ANGLE: f64 = 3.0;
/// Largest angle of a lens whose radius grows with the tangent.
const WIDEST_PERSPECTIVE: f64 = FRAC_PI_2 - 0.01;
/// Radii and azimuths at which a lens is tested for folds.
const FOLD_RADII: usize = 256;
const FOLD_AZIMUTHS: usize = 8;
/// Farthest start of the backward pass from a position, of the limit: there the picture folds, and a step may lead anywhere.
const START: f64 = 0.9;
/// Below this ratio (ρ / z)² the angle is a series.
const SERIES_BELOW: f64 = 0.05;
const SERIES_TERMS: usize = 16;

/// A point seen through a lens.
#[derive(Clone, Copy, Debug)]
pub struct Seen {
    /// Focal lengths from the principal point.
    pub position: [f64; 2],
    /// Derivative of the position by the point in camera axes, by rows, focal lengths per world unit.
    pub jacobian: [[f64; 3]; 2],
}

/// A [`Distortion`] up to the radius at which it would fold.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(from = "Distortion", into = "Distortion")]
pub struct Lens {
    distortion: Distortion,
    /// Largest undistorted radius at which the lens is one to one.
    limit: f64,
}

impl From<Distortion> for Lens {
    fn from(distortion: Distortion) -> Self {
        Self::new(distortion)
    }
}

impl From<Lens> for Distortion {
    fn from(lens: Lens) -> Self {
        lens.distortion
    }
}

/// The factor s of (a, b) = s (x, y), and its derivatives with respect to w = x² + y² and z.
struct Scale {
    s: f64,
    w: f64,
    z: f64,
    ww: f64,
    wz: f64,
    zz: f64,
}

impl Lens {
    pub fn new(distortion: Distortion) -> Self {
        let mut lens = Self { distortion, limit: 0.0 };
        let widest = if lens.is_wide() { WIDEST_ANGLE } else { WIDEST_PERSPECTIVE };
        let radius = |step: usize| lens.radius(widest * step as f64 / FOLD_RADII as f64);
        let first_fold = (1..=FOLD_RADII).find(|&step| !lens.is_one_to_one(radius(step)));
        lens.limit = match first_fold {
            None => radius(FOLD_RADII),
            Some(step) => {
                let (mut low, mut high) = (radius(step - 1), radius(step));
                for _ in 0..40 {
                    let middle = 0.5 * (low + high);
                    if lens.is_one_to_one(middle) { low = middle } else { high = middle }
                }
                low
            }
        };
        lens
    }

    pub fn distortion(&self) -> &Distortion {
        &self.distortion
    }

    /// Whether its numbers are finite, also in f32, and it shows anything.
    pub fn is_sound(&self) -> bool {
        let d = &self.distortion;
        let numbers = [&d.numerator[..], &d.denominator, &d.tangential, &d.thin_prism, &d.thin_prism_quartic];
        let projects = match d.projection {
            Projection::FieldOfView(omega) => omega > 1e-3 && omega < std::f64::consts::PI,
            Projection::Perspective | Projection::Equidistant => true,
        };
        projects && numbers.concat().iter().all(|&v| (v as f32).is_finite()) && self.limit > 0.0
    }

    /// Largest undistorted radius that it sees.
    pub fn limit(&self) -> f64 {
        self.limit
    }

    /// Whether depth is the distance from the camera's centre; otherwise it is camera-space z.
    pub fn is_wide(&self) -> bool {
        self.distortion.projection != Projection::Perspective
    }

    /// κ and ω of `r = atan2(κ sin θ, cos θ) / ω`; `None` for [`Projection::Perspective`].
    pub fn arc(&self) -> Option<[f64; 2]> {
        match self.distortion.projection {
            Projection::Perspective => None,
            Projection::Equidistant => Some([1.0, 1.0]),
            Projection::FieldOfView(omega) => Some([2.0 * (0.5 * omega).tan(), omega]),
        }
    }

    fn is_one_to_one(&self, radius: f64) -> bool {
        let m = radius * radius;
        let [value, slope, _] = self.distortion.factor(m);
        let outwards = value > 0.0 && value + 2.0 * m * slope > 0.0;
        let grows = |azimuth: usize| {
            let (sin, cos) = (std::f64::consts::TAU * azimuth as f64 / FOLD_AZIMUTHS as f64).sin_cos();
            let [[xx, xy], [yx, yy]] = self.distortion.jacobian(radius * cos, radius * sin);
            xx * yy - xy * yx > 0.0
        };
        outwards && (self.distortion.is_radial() || (0..FOLD_AZIMUTHS).all(grows))
    }

    /// Undistorted radius at an angle from the optical axis; infinite where the lens cannot see.
    pub fn radius(&self, angle: f64) -> f64 {
        match self.arc() {
            None if angle < FRAC_PI_2 => angle.tan(),
            None => f64::INFINITY,
            Some([kappa, omega]) => (kappa * angle.sin()).atan2(angle.cos()) / omega,
        }
    }

    /// Distorted radius at an undistorted one, without what is tangential.
    pub fn radial(&self, radius: f64) -> f64 {
        radius * self.distortion.factor(radius * radius)[0]
    }

    /// Depth of a point in camera axes, world units: z, or the distance of a wide lens.
    pub fn depth(&self, [x, y, z]: [f64; 3]) -> f64 {
        if self.is_wide() { (x * x + y * y + z * z).sqrt() } else { z }
    }

    fn scale(&self, w: f64, z: f64) -> Scale {
        let Some([kappa, omega]) = self.arc() else {
            let s = 1.0 / z;
            return Scale { s, w: 0.0, z: -s * s, ww: 0.0, wz: 0.0, zz: 2.0 * s * s * s };
        };
        // s = (κ / ω) S(κ² w, z) with S = θ / ρ
        let (gain, square) = (kappa / omega, kappa * kappa);
        let w = square * w;
        let squared = w + z * z;
        let (s, s_w, s_ww) = if z > 0.0 && w < SERIES_BELOW * z * z {
            arctangent_series(w / (z * z), z)
        } else {
            let s = w.sqrt().atan2(z) / w.sqrt();
            let s_w = (z / squared - s) / (2.0 * w);
            (s, s_w, (-z / (squared * squared) - 3.0 * s_w) / (2.0 * w))
        };
        Scale {
            s: gain * s,
            w: gain * square * s_w,
            z: -gain / squared,
            ww: gain * square * square * s_ww,
            wz: gain * square / (squared * squared),
            zz: gain * 2.0 * z / (squared * squared),
        }
    }

    /// The undistorted position of a point in camera axes; `None` where the lens does not see.
    fn undistorted(&self, [x, y, z]: [f64; 3]) -> Option<[f64; 2]> {
        if !self.is_wide() {
            let (a, b) = (x / z, y / z);
            return (z > 0.0 && a * a + b * b <= self.limit * self.limit).then_some([a, b]);
        }
        let s = self.scale(x * x + y * y, z).s;
        let (a, b) = (s * x, s * y);
        (a * a + b * b <= self.limit * self.limit).then_some([a, b])
    }

    /// Position of a point in camera axes, focal lengths from the principal point; `None` where the lens does not see.
    pub fn position(&self, point: [f64; 3]) -> Option<[f64; 2]> {
        self.undistorted(point).map(|[a, b]| self.distortion.apply(a, b))
    }

    fn undistorted_jacobian([x, y, _]: [f64; 3], scale: &Scale) -> [[f64; 3]; 2] {
        let across = 2.0 * x * y * scale.w;
        [[scale.s + 2.0 * x * x * scale.w, across, x * scale.z], [across, scale.s + 2.0 * y * y * scale.w, y * scale.z]]
    }

    /// A point in camera axes as the lens shows it; `None` where it does not see.
    pub fn look(&self, point: [f64; 3]) -> Option<Seen> {
        let [a, b] = self.undistorted(point)?;
        let [x, y, z] = point;
        let inner = Self::undistorted_jacobian(point, &self.scale(x * x + y * y, z));
        let outer = self.distortion.jacobian(a, b);
        let jacobian = outer.map(|row| std::array::from_fn(|k| row[0] * inner[0][k] + row[1] * inner[1][k]));
        Some(Seen { position: self.distortion.apply(a, b), jacobian })
    }

    /// Gradient with respect to a point that the lens sees, from those with respect to its [`Seen`].
    pub fn look_backward(&self, point: [f64; 3], grad_position: [f64; 2], grad_jacobian: [[f64; 3]; 2]) -> [f64; 3] {
        let [x, y, z] = point;
        let scale = self.scale(x * x + y * y, z);
        let inner = Self::undistorted_jacobian(point, &scale);
        let (a, b) = (scale.s * x, scale.s * y);
        let outer = self.distortion.jacobian(a, b);
        let dot = |u: &[f64; 3], v: &[f64; 3]| u[0] * v[0] + u[1] * v[1] + u[2] * v[2];
        // J = outer · inner
        let grad_outer = grad_jacobian.map(|row| [dot(&row, &inner[0]), dot(&row, &inner[1])]);
        let of_inner = |i: usize| -> [f64; 3] {
            std::array::from_fn(|k| outer[0][i] * grad_jacobian[0][k] + outer[1][i] * grad_jacobian[1][k])
        };
        let bent = self.distortion.jacobian_backward(a, b, grad_outer);
        let towards: [f64; 2] =
            std::array::from_fn(|i| outer[0][i] * grad_position[0] + outer[1][i] * grad_position[1] + bent[i]);
        // of the inner Jacobian: q s + 2 p s_w + l s_z
        let (first, second) = (of_inner(0), of_inner(1));
        let mixed = first[1] + second[0];
        let q = first[0] + second[1];
        let p = first[0] * x * x + mixed * x * y + second[1] * y * y;
        let l = first[2] * x + second[2] * y;
        let common = 2.0 * (q * scale.w + 2.0 * p * scale.ww + l * scale.wz);
        let own = [
            x * common + 2.0 * scale.w * (2.0 * first[0] * x + mixed * y) + first[2] * scale.z,
            y * common + 2.0 * scale.w * (mixed * x + 2.0 * second[1] * y) + second[2] * scale.z,
            q * scale.z + 2.0 * p * scale.wz + l * scale.zz,
        ];
        std::array::from_fn(|k| own[k] + towards[0] * inner[0][k] + towards[1] * inner[1][k])
    }

    /// The ray that appears at a position in focal lengths from the principal point: camera axes, of length 1 for a wide
    /// lens and of z 1 otherwise, so that depth times it is the point. `None` where the lens shows nothing.
    pub fn ray(&self, position: [f64; 2]) -> Option<[f64; 3]> {
        let [a, b] = self.undistort(position)?;
        Some(self.direction(a, b))
    }

    /// Whether there is a [`ray`](Self::ray) at a position.
    pub fn shows(&self, position: [f64; 2]) -> bool {
        if self.distortion.is_radial() {
            position[0].hypot(position[1]) <= self.radial(self.limit)
        } else {
            self.undistort(position).is_some()
        }
    }

    /// [`ray`](Self::ray), or that at the limit in the same direction where the lens shows nothing.
    pub fn nearest_ray(&self, position: [f64; 2]) -> [f64; 3] {
        let [a, b] = self.undistort(position).unwrap_or_else(|| {
            let share = self.limit / position[0].hypot(position[1]);
            position.map(|v| share * v)
        });
        self.direction(a, b)
    }

    fn direction(&self, a: f64, b: f64) -> [f64; 3] {
        let Some([kappa, omega]) = self.arc() else { return [a, b, 1.0] };
        let radius = a.hypot(b);
        let (sin, cos) = (omega * radius).sin_cos();
        let share = if radius > 1e-9 { sin / (kappa * radius) } else { omega / kappa };
        let (x, y) = (share * a, share * b);
        let length = (x * x + y * y + cos * cos).sqrt();
        [x / length, y / length, cos / length]
    }

    /// Inverse of [`Distortion::apply`] within the limit, by Newton's method.
    fn undistort(&self, [x, y]: [f64; 2]) -> Option<[f64; 2]> {
        let target = x.hypot(y);
        if !target.is_finite() {
            return None;
        }
        if target == 0.0 && self.distortion.is_radial() {
            return Some([0.0, 0.0]);
        }
        let radius = self.inverse_radial(target);
        if self.distortion.is_radial() {
            let share = radius? / target;
            return Some([share * x, share * y]);
        }
        let start = radius.unwrap_or(self.limit).min(START * self.limit);
        let share = if target > 0.0 { start / target } else { 0.0 };
        let (mut a, mut b) = (share * x, share * y);
        for _ in 0..32 {
            let found = self.distortion.apply(a, b);
            let (dx, dy) = (x - found[0], y - found[1]);
            let [[xx, xy], [yx, yy]] = self.distortion.jacobian(a, b);
            let determinant = xx * yy - xy * yx;
            let (step_a, step_b) = ((yy * dx - xy * dy) / determinant, (xx * dy - yx * dx) / determinant);
            (a, b) = (a + step_a, b + step_b);
            if step_a.hypot(step_b) <= 1e-15 * (1.0 + a.hypot(b)) {
                break;
            }
        }
        let [found_x, found_y] = self.distortion.apply(a, b);
        let is_found = (found_x - x).hypot(found_y - y) < 1e-9 * (1.0 + target) && a.hypot(b) <= self.limit;
        is_found.then_some([a, b])
    }

    /// The undistorted radius of a distorted one; `None` beyond the limit. [`radial`](Self::radial) ascends up to there.
    fn inverse_radial(&self, target: f64) -> Option<f64> {
        let (mut low, mut high) = (0.0, self.limit);
        if target > self.radial(high) {
            return None;
        }
        let mut radius = target.min(high);
        for _ in 0..64 {
            let m = radius * radius;
            let [value, slope, _] = self.distortion.factor(m);
            let excess = radius * value - target;
            if excess > 0.0 {
                high = radius
            } else {
                low = radius
            }
            let newton = radius - excess / (value + 2.0 * m * slope);
            // Newton's step where it stays in the bracket, otherwise its middle
            let next = if newton >= low && newton <= high { newton } else { 0.5 * (low + high) };
            let step = (next - radius).abs();
            radius = next;
            if step <= 1e-15 * (1.0 + radius) {
                break;
            }
        }
        Some(radius)
    }
}

/// θ / ρ at m = ρ² / z², z > 0, and its first two derivatives with respect to ρ², by the series of the arctangent.
fn arctangent_series(m: f64, z: f64) -> (f64, f64, f64) {
    let (mut s, mut first, mut second, mut power) = (0.0, 0.0, 0.0, 1.0);
    for i in 0..SERIES_TERMS {
        // (−1)ⁱ / (2i + 1) of mⁱ, and those of the derivatives at the same power
        let term = |i: usize| {
            let sign = if i.is_multiple_of(2) { 1.0 } else { -1.0 };
            sign / (2 * i + 1) as f64
        };
        s += term(i) * power;
        first += (i + 1) as f64 * term(i + 1) * power;
        second += ((i + 1) * (i + 2)) as f64 * term(i + 2) * power;
        power *= m;
    }
    let cube = z * z * z;
    (s / z, first / cube, second / (cube * z * z))
}
