//! The footprint of a Gaussian at the pixels of a vector, and those of as many Gaussians as a vector has numbers.

use pulp::Simd;

use super::Splat;
use crate::backend::lanes::{Lanes, Mask};
use crate::backend::real::Real;
use crate::backend::vectors::MOST;
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

impl<T: Real, S: Simd> Splat<Lanes<T, S>> {
    /// Those of the lanes in which `visible` is set.
    #[inline(always)]
    pub fn apart(&self, visible: Mask<T, S>) -> [Option<Splat<T>>; MOST] {
        let simd = self.strength.simd();
        let ([x, y], [p, q, r], [a, c], [red, green, blue]) = (self.mean, self.root, self.variances, self.colour);
        let drawn = Lanes::splat(simd, T::one()).only(visible);
        let rows = Lanes::to_rows([
            x,
            y,
            p,
            q,
            r,
            a,
            c,
            self.strength,
            self.depth,
            red,
            green,
            blue,
            self.squared_radius,
            drawn,
        ]);
        let mut splats = [None; MOST];
        for (out, [x, y, p, q, r, a, c, strength, depth, red, green, blue, squared_radius, drawn]) in
            splats.iter_mut().zip(rows).take(T::lane_count::<S>())
        {
            *out = (drawn > T::zero()).then_some(Splat {
                mean: [x, y],
                root: [p, q, r],
                variances: [a, c],
                strength,
                depth,
                colour: [red, green, blue],
                squared_radius,
            });
        }
        splats
    }

    /// `splat(lane)` in each lane.
    #[inline(always)]
    pub fn together<'a>(simd: S, splat: impl Fn(usize) -> &'a Splat<T>) -> Self {
        let [x, y, p, q, r, a, c, strength, depth, red, green, blue, squared_radius] = Lanes::from_rows(
            simd,
            #[inline(always)]
            |lane| {
                let Splat { mean: [x, y], root: [p, q, r], variances: [a, c], colour: [red, green, blue], .. } =
                    *splat(lane);
                let Splat { strength, depth, squared_radius, .. } = *splat(lane);
                [x, y, p, q, r, a, c, strength, depth, red, green, blue, squared_radius]
            },
        );
        let (mean, root, variances, colour) = ([x, y], [p, q, r], [a, c], [red, green, blue]);
        Self { mean, root, variances, strength, depth, colour, squared_radius }
    }
}
