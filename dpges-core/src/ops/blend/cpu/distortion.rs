//! Depth distortion (2DGS): `Σ_{j<i} w_i w_j (m_i − m_j)²` from running sums of w, w m and w m².
//!
//! Only differences of m count, so m is taken relative to that of a pixel's first fragment: of
//! m = far / (far − near) · (1 − near / z) itself f32 would leave nothing but rounding where z ≫ near.

use super::walk::group;
use crate::backend::real::Real;
use crate::backend::simd::LANES;
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

    /// Adds a fragment at `depth` to a group of pixels, `covered` αT each, where that is not 0, and returns by how
    /// much distortion grows. `through` is T behind it.
    #[inline(always)]
    pub fn add(&mut self, start: usize, covered: &[T; LANES], through: &[T; LANES], depth: &[T; LANES]) -> [T; LANES] {
        let reference = group(&mut self.reference, start);
        let first = group(&mut self.first, start);
        let second = group(&mut self.second, start);
        let two = T::of(2.0);
        let mut growth = [T::zero(); LANES];
        for lane in 0..LANES {
            let blended = covered[lane] != T::zero();
            let inverse = T::one() / depth[lane];
            let fresh = blended & (reference[lane] == T::zero());
            reference[lane] = if fresh { inverse } else { reference[lane] };
            let m = if blended { self.slope * (reference[lane] - inverse) } else { T::zero() };
            let before = T::one() - (through[lane] + covered[lane]);
            growth[lane] = covered[lane] * (m * m * before + second[lane] - two * m * first[lane]);
            first[lane] = first[lane] + covered[lane] * m;
            second[lane] = second[lane] + covered[lane] * m * m;
        }
        growth
    }
}
