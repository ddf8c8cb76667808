//! Moments of a value over the pixels of a primitive.

use pulp::Simd;

use crate::backend::lanes::Lanes;
use crate::backend::real::Real;

/// Number of moments up to the first order.
pub const FIRST_MOMENTS: usize = 3;
/// Number of moments up to the second order.
pub const MOMENTS: usize = 6;

/// Adds pixels at offsets (`dx`, `dy`) px to Σ g, Σ g dx, Σ g dy.
#[inline(always)]
pub fn add_first_moments<T: Real, S: Simd>(sums: &mut [Lanes<T, S>], g: Lanes<T, S>, dx: Lanes<T, S>, dy: Lanes<T, S>) {
    let [sum, sum_x, sum_y] = sums else {
        unreachable!("three sums");
    };
    (*sum, *sum_x, *sum_y) = (*sum + g, g.mul_add(dx, *sum_x), g.mul_add(dy, *sum_y));
}

/// Adds pixels at (`u`, `v`) to Σ g, Σ g u, Σ g v, Σ g u², Σ g u v, Σ g v².
#[inline(always)]
pub fn add_moments<T: Real, S: Simd>(sums: &mut [Lanes<T, S>], g: Lanes<T, S>, u: Lanes<T, S>, v: Lanes<T, S>) {
    let [sum, sum_u, sum_v, sum_uu, sum_uv, sum_vv] = sums else {
        unreachable!("six sums");
    };
    // two products serve five sums
    let (gu, gv) = (g * u, g * v);
    (*sum, *sum_u, *sum_v) = (*sum + g, *sum_u + gu, *sum_v + gv);
    (*sum_uu, *sum_uv, *sum_vv) = (gu.mul_add(u, *sum_uu), gu.mul_add(v, *sum_uv), gv.mul_add(v, *sum_vv));
}
