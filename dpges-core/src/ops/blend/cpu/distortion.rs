//! Depth distortion (2DGS): `Σ_{j<i} w_i w_j (m_i − m_j)²` from running sums of w, w m and w m².
//!
//! Only differences of m count, so m is taken relative to that of a pixel's first fragment: of
//! m = far / (far − near) · (1 − near / z) itself f32 would leave nothing but rounding where z ≫ near.

use pulp::Simd;

use super::walk::Fragments;
use crate::backend::lanes::Lanes;
use crate::backend::real::Real;
use crate::math::CameraOf;
use crate::ops::blend::far;
use crate::tiles::TILE_PIXELS;

/// d m / d(−1 / z)
pub fn slope<T: Real>(camera: &CameraOf<T>) -> T {
    let near = camera.near.as_f64();
    T::of(far(near) * near / (far(near) - near))
}

/// Running sums of the pixels of a tile. That of w is 1 − T.
pub struct Spread<T> {
    slope: T,
    /// 1 / z of the first fragment, 0 before it.
    pub reference: [T; TILE_PIXELS],
    /// Σ w m
    pub first: [T; TILE_PIXELS],
    /// Σ w m²
    pub second: [T; TILE_PIXELS],
}

impl<T: Real> Spread<T> {
    #[inline(always)]
    pub fn new(slope: T) -> Self {
        let zero = [T::zero(); TILE_PIXELS];
        Self { slope, reference: zero, first: zero, second: zero }
    }

    /// Adds fragments to the pixels from `start` on, and returns by how much distortion grows.
    #[inline(always)]
    pub fn add<S: Simd>(&mut self, start: usize, fragments: &Fragments<T, S>) -> Lanes<T, S> {
        let &Fragments { blended, depth, covered, through } = fragments;
        let simd = depth.simd();
        let all = |value: T| Lanes::splat(simd, value);
        let reference = Lanes::load(simd, &self.reference[start..]);
        let first = Lanes::load(simd, &self.first[start..]);
        let second = Lanes::load(simd, &self.second[start..]);
        let inverse = all(T::one()) / depth;
        // 1 / z is never 0, which therefore stands for no fragment so far
        let fresh = blended & all(T::zero()).at_least(reference);
        let reference = Lanes::select(fresh, inverse, reference);
        let m = (all(self.slope) * (reference - inverse)).only(blended);
        // Σ w of the fragments before is 1 − T, and T before this one is what it leaves and what it covers
        let before = all(T::one()) - (through + covered);
        let growth = covered * (m * m * before + second - all(T::of(2.0)) * m * first);
        reference.store(&mut self.reference[start..]);
        covered.mul_add(m, first).store(&mut self.first[start..]);
        (covered * m).mul_add(m, second).store(&mut self.second[start..]);
        growth
    }
}
