//! Moments of a value over the pixels of a primitive, a group of lanes at a time.

use pulp::Simd;

use crate::backend::lanes::Lanes;
use crate::backend::real::Real;
use crate::backend::simd::LANES;

/// Number of moments up to the first order.
pub const FIRST_MOMENTS: usize = 3;
/// Number of moments up to the second order.
pub const MOMENTS: usize = 6;

/// Adds a group of pixels, at offsets (`dx`, `dy`) px, to Σ g, Σ g dx, Σ g dy.
#[inline(always)]
pub fn add_first_moments<T: Real>(sums: &mut [[T; LANES]], g: &[T; LANES], dx: &[T; LANES], dy: T) {
    let [sum, sum_x, sum_y] = sums else {
        unreachable!("three rows of lanes");
    };
    for lane in 0..LANES {
        sum[lane] = sum[lane] + g[lane];
    }
    for lane in 0..LANES {
        sum_x[lane] = sum_x[lane] + g[lane] * dx[lane];
    }
    for lane in 0..LANES {
        sum_y[lane] = sum_y[lane] + g[lane] * dy;
    }
}

/// Adds a group of pixels, at (`u`, `v`), to Σ g, Σ g u, Σ g v, Σ g u², Σ g u v, Σ g v².
#[inline(always)]
pub fn add_moments<T: Real>(sums: &mut [[T; LANES]], g: &[T; LANES], u: &[T; LANES], v: T) {
    let (first, second) = sums.split_at_mut(FIRST_MOMENTS);
    add_first_moments(first, g, u, v);
    let [sum_uu, sum_uv, sum_vv] = second else {
        unreachable!("three rows of lanes");
    };
    for lane in 0..LANES {
        sum_uu[lane] = sum_uu[lane] + g[lane] * u[lane] * u[lane];
    }
    for lane in 0..LANES {
        sum_uv[lane] = sum_uv[lane] + g[lane] * u[lane] * v;
    }
    for lane in 0..LANES {
        sum_vv[lane] = sum_vv[lane] + g[lane] * v * v;
    }
}

/// [`add_moments`] of pixels in a vector.
#[inline(always)]
pub fn add_moments_of_lanes<T: Real, S: Simd>(
    sums: &mut [Lanes<T, S>; MOMENTS],
    g: Lanes<T, S>,
    u: Lanes<T, S>,
    v: Lanes<T, S>,
) {
    let (gu, gv) = (g * u, g * v);
    let [sum, sum_u, sum_v, sum_uu, sum_uv, sum_vv] = *sums;
    *sums = [sum + g, sum_u + gu, sum_v + gv, gu.mul_add(u, sum_uu), gu.mul_add(v, sum_uv), gv.mul_add(v, sum_vv)];
}
