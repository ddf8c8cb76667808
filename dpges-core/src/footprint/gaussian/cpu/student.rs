//! The footprint of a Gaussian with a kernel of Student's t distribution, and an opacity of either sign (SSS).
//!
//! α = o (1 + r² / ν)^(−(ν + 2) / 2) at r standard deviations from the mean. There is no low-pass filter.

use pulp::Simd;

use super::{ParameterGrad, Parameters, Splat, SplatGrad};
use crate::backend::lanes::{Lanes, Mask};
use crate::backend::real::Real;
use crate::backend::vectors::MOST;
use crate::footprint::CUTOFF;
use crate::footprint::gaussian::{STUDENT_LEAST_REACH, STUDENT_LEAST_SPREAD, STUDENT_REACH};
use crate::math::{CameraOf, V3};
use crate::scene::ScreenFilter;
use crate::tiles::PixelRect;

/// Footprint of one such Gaussian.
#[derive(Clone, Copy, Debug)]
pub struct Student<T> {
    /// Its strength is |o|, its squared radius that at which |α| reaches the cutoff.
    pub ellipse: Splat<T>,
    pub opacity: T,
    /// ν
    pub degrees: T,
    /// Largest offset from the mean in x or y at which it is drawn, px.
    bound: T,
}

/// Standard deviations of the major axis up to which a kernel is drawn.
fn reach_of(degrees: f64) -> f64 {
    let whole = degrees.floor();
    match STUDENT_REACH.get(whole as usize - 1..=whole as usize) {
        Some(&[own, next]) => (own - next) * (degrees - whole) + next,
        _ => STUDENT_LEAST_REACH,
    }
}

impl<T: Real> Student<T> {
    /// `None` where [`Splat::new`] has none for |o|, and with fewer than one degree of freedom.
    #[inline(always)]
    pub fn new(camera: &CameraOf<T>, p: &Parameters<T>, colour: V3<T>) -> Option<Self> {
        let (opacity, degrees, two) = (p.opacity, p.degrees_of_freedom, T::of(2.0));
        let magnitude = Parameters { opacity: opacity.abs(), ..*p };
        let mut ellipse = Splat::new(camera, &magnitude, colour, ScreenFilter::Off).filter(|_| degrees >= T::one())?;
        // ν ((255 |o|)^(2 / (ν + 2)) − 1)
        let fall = (ellipse.strength / T::of(CUTOFF)).ln();
        // `exp_m1`: with large ν the exponential is 1 but for its last digits, and ν would magnify their rounding
        ellipse.squared_radius = degrees * (two / (degrees + two) * fall).exp_m1();
        let [p, q, r] = ellipse.root;
        let [variance_x, variance_y] = ellipse.variances;
        let (half_difference, covariance) = ((variance_x - variance_y) / two, -q / (p * r * r));
        let spread = (half_difference * half_difference + covariance * covariance).max(T::of(STUDENT_LEAST_SPREAD));
        let largest = (variance_x + variance_y) / two + spread.sqrt();
        let bound = (T::of(reach_of(degrees.as_f64())) * largest.sqrt()).ceil();
        Some(Self { ellipse, opacity, degrees, bound })
    }

    /// Pixels at which it can be drawn.
    pub fn reach(&self, width: usize, height: usize) -> PixelRect {
        self.ellipse.reach_within(self.bound.as_f64() * (1.0 + 1e-6), width, height)
    }

    /// r², and ln(1 + r² / ν), at offsets (`dx`, `dy`) px from the mean.
    #[inline(always)]
    fn falls<S: Simd>(&self, dx: Lanes<T, S>, dy: T) -> [Lanes<T, S>; 2] {
        let all = |value: T| Lanes::splat(dx.simd(), value);
        let [p, q, r] = self.ellipse.root;
        let (u, v, degrees) = (all(p).mul_add(dx, all(q * dy)), all(r * dy), all(self.degrees));
        let squared = u.mul_add(u, v * v);
        let near = (squared / degrees).min(all(T::one())).ln_1p_share();
        // few pixels are so far out, and the library's logarithm does not vectorise
        let beyond = degrees.below(squared);
        if !beyond.any() {
            return [squared, near];
        }
        let mut far = [T::zero(); MOST];
        squared.store(&mut far);
        let share = |squared: T| if squared > self.degrees { (squared / self.degrees).ln_1p() } else { T::zero() };
        let far = far.map(share);
        [squared, Lanes::select(beyond, Lanes::load(dx.simd(), &far), near)]
    }

    /// Where α reaches the cutoff within its bounds, and α before it is capped.
    #[inline(always)]
    pub fn weights<S: Simd>(&self, dx: Lanes<T, S>, dy: T) -> (Mask<T, S>, Lanes<T, S>) {
        let all = |value: T| Lanes::splat(dx.simd(), value);
        let [_, fall] = self.falls(dx, dy);
        let exponent = all(T::of(-0.5) * (self.degrees + T::of(2.0)));
        let alpha = all(self.opacity) * (exponent * fall).exp_nonpositive();
        let near = all(self.bound).at_least(dx.abs().max(all(dy.abs())));
        (near & alpha.abs().at_least(all(T::of(CUTOFF))), alpha)
    }

    /// −2 and 1 times the derivatives of the exponent of α with respect to r² and ν: (ν + 2) / (ν + r²) and
    /// ½ (x (1 + 2 / ν) / (1 + x) − ln(1 + x)) with x = r² / ν.
    #[inline(always)]
    pub fn slopes<S: Simd>(&self, dx: Lanes<T, S>, dy: T) -> [Lanes<T, S>; 2] {
        let all = |value: T| Lanes::splat(dx.simd(), value);
        let [squared, fall] = self.falls(dx, dy);
        let degrees = all(self.degrees);
        let share = squared / (degrees + squared);
        let by_degrees = all(T::of(0.5)) * (share - fall) + share / degrees;
        [all(self.degrees + T::of(2.0)) / (degrees + squared), by_degrees]
    }
}

/// Gradients with respect to the raw parameters, from the moments of `sum`, in which g is that of r² times −2, and from the
/// sums of the gradients of the exponent `power` and of ν.
pub fn backward<T: Real>(
    camera: &CameraOf<T>,
    p: &Parameters<T>,
    student: &Student<T>,
    sum: &SplatGrad<T>,
    [power, of_degrees]: [T; 2],
) -> ParameterGrad<T> {
    let magnitude = Parameters { opacity: p.opacity.abs(), ..*p };
    let of_ellipse = super::backward(camera, &magnitude, &student.ellipse, sum, ScreenFilter::Off);
    ParameterGrad { opacity: power / p.opacity, degrees_of_freedom: of_degrees, ..of_ellipse }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bounds_are_those_of_the_published_table() {
        let cases =
            [(1.0, 9.925), (1.5, 36.791), (2.0, 5.841), (3.0, 4.604), (12.0, 3.012), (12.5, 3.0335), (13.0, 3.0)];
        for (degrees, expected) in cases {
            assert!((reach_of(degrees) - expected).abs() < 1e-9, "{degrees}: {}", reach_of(degrees));
        }
        assert_eq!((reach_of(100.0), reach_of(1e4)), (3.0, 3.0));
    }
}
