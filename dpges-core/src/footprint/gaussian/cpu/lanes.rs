//! The footprint of a Gaussian at the pixels of a vector.

use pulp::Simd;

use super::Splat;
use crate::backend::lanes::Lanes;
use crate::backend::real::Real;
use crate::footprint::CUTOFF;

/// A [`Splat`] for many pixels.
#[derive(Clone, Copy)]
pub struct SplatLanes<T: Real, S: Simd> {
    simd: S,
    p: Lanes<T, S>,
    q: T,
    r: T,
    strength: Lanes<T, S>,
    /// Below it a weight is below the cutoff for certain.
    least_exponent: Lanes<T, S>,
    cutoff: Lanes<T, S>,
}

/// Offsets from the mean in units of the standard deviations, and the weight there.
pub struct At<T: Real, S: Simd> {
    pub u: Lanes<T, S>,
    pub v: T,
    pub weight: Lanes<T, S>,
}

impl<T: Real, S: Simd> SplatLanes<T, S> {
    #[inline(always)]
    pub fn new(simd: S, splat: &Splat<T>) -> Self {
        let [p, q, r] = splat.root;
        let all = |value: T| Lanes::splat(simd, value);
        // wider than its rounding, so that no pixel is left out that the comparison with the cutoff would keep
        let least_exponent = all(T::of(-0.5) * splat.squared_radius * T::of(1.0 + 1e-4) - T::of(1e-4));
        Self { simd, p: all(p), q, r, strength: all(splat.strength), least_exponent, cutoff: all(T::of(CUTOFF)) }
    }

    /// At offsets (`dx`, `dy`) from the mean, px; as [`Splat::in_deviations`] and [`Splat::weight`] of single pixels. `None`
    /// where no pixel reaches the cutoff.
    #[inline(always)]
    pub fn at(&self, dx: Lanes<T, S>, dy: T) -> Option<At<T, S>> {
        let all = |value: T| Lanes::splat(self.simd, value);
        let (u, v) = (self.p.mul_add(dx, all(self.q * dy)), self.r * dy);
        let exponent = u.mul_add(u, all(v * v)) * all(T::of(-0.5));
        // most rows of the box around a thin ellipse end here, before their exponentials, which cost most
        if !exponent.at_least(self.least_exponent).any() {
            return None;
        }
        let weight = self.strength * exponent.exp_nonpositive();
        Some(At { u, v, weight: weight.only(weight.at_least(self.cutoff)) })
    }
}
