//! Sums and products of f32 numbers without rounding errors, as unevaluated sums of two numbers (Dekker, Knuth).
//!
//! These functions rely on the rounding of `(a + b) − a`, which shader compilers may simplify to `b`. Results
//! that must be rounded therefore pass through [`opaque`]: an exclusive or with a zero that only the host knows.

use cubecl::prelude::*;

use super::vector::{Vec3, vec3};

/// The number high + low. |low| is at most half a unit in the last place of high.
#[derive(CubeType, Clone, Copy)]
#[expand(derive(Clone, Copy))]
pub struct Pair {
    pub high: f32,
    pub low: f32,
}

#[cube]
pub fn opaque(x: f32, zero: u32) -> f32 {
    f32::reinterpret(u32::reinterpret(x) ^ zero)
}

/// a + b
#[cube]
pub fn two_sum(a: f32, b: f32, zero: u32) -> Pair {
    // Knuth's sum, which needs no branch on which of the two is larger, as Dekker's does
    let high = opaque(a + b, zero);
    let of_b = opaque(high - a, zero);
    let of_a = opaque(high - of_b, zero);
    Pair { high, low: opaque(a - of_a, zero) + opaque(b - of_b, zero) }
}

/// x with the upper half of its significand. x minus this is exact.
#[cube]
fn upper(x: f32) -> f32 {
    // a mask, since Dekker's product with 2¹² + 1 overflows near the largest f32; what is left has 12 bits
    f32::reinterpret(u32::reinterpret(x) & 0xffff_f000u32)
}

/// a · b
#[cube]
pub fn two_product(a: f32, b: f32, zero: u32) -> Pair {
    // products of halves of 12 bits are exact; `fma` would do with less, but WGSL lets it round twice
    let high = opaque(a * b, zero);
    let (a1, b1) = (upper(a), upper(b));
    let (a2, b2) = (opaque(a - a1, zero), opaque(b - b1, zero));
    let e1 = opaque(opaque(a1 * b1, zero) - high, zero);
    let e2 = opaque(e1 + opaque(a1 * b2, zero), zero);
    let e3 = opaque(e2 + opaque(a2 * b1, zero), zero);
    Pair { high, low: e3 + opaque(a2 * b2, zero) }
}

#[cube]
pub fn add_pairs(a: Pair, b: Pair, zero: u32) -> Pair {
    // low parts are added with rounding, by about 2⁻⁴⁸ of the larger operand
    let sum = two_sum(a.high, b.high, zero);
    two_sum(sum.high, sum.low + a.low + b.low, zero)
}

#[cube]
pub fn multiply_pairs(a: Pair, b: Pair, zero: u32) -> Pair {
    // low · low is left out: it lies below the last digit of a pair
    let product = two_product(a.high, b.high, zero);
    two_sum(product.high, product.low + (a.high * b.low + a.low * b.high), zero)
}

#[cube]
pub fn exactly(x: f32) -> Pair {
    Pair { high: x, low: 0.0f32 }
}

#[cube]
pub fn negated(a: Pair) -> Pair {
    Pair { high: -a.high, low: -a.low }
}

#[cube]
pub fn divide_pairs(a: Pair, b: Pair, zero: u32) -> Pair {
    // one step of long division: what is left of a after `first` gives the second number
    let first = opaque(a.high / b.high, zero);
    let rest = add_pairs(a, negated(multiply_pairs(exactly(first), b, zero)), zero);
    two_sum(first, rest.high / b.high, zero)
}

/// A three-vector of pairs.
#[derive(CubeType, Clone, Copy)]
#[expand(derive(Clone, Copy))]
pub struct Pairs3 {
    pub x: Pair,
    pub y: Pair,
    pub z: Pair,
}

#[cube]
pub fn dot_pairs(a: Pairs3, b: Pairs3, zero: u32) -> Pair {
    let across = add_pairs(multiply_pairs(a.x, b.x, zero), multiply_pairs(a.y, b.y, zero), zero);
    add_pairs(across, multiply_pairs(a.z, b.z, zero), zero)
}

#[cube]
fn minor(a: Pair, b: Pair, c: Pair, d: Pair, zero: u32) -> Pair {
    add_pairs(multiply_pairs(a, d, zero), negated(multiply_pairs(b, c, zero)), zero)
}

#[cube]
pub fn cross_pairs(a: Pairs3, b: Pairs3, zero: u32) -> Pairs3 {
    Pairs3 {
        x: minor(a.y, a.z, b.y, b.z, zero),
        y: minor(a.z, a.x, b.z, b.x, zero),
        z: minor(a.x, a.y, b.x, b.y, zero),
    }
}

#[cube]
pub fn rounded(a: Pairs3) -> Vec3 {
    vec3(a.x.high, a.y.high, a.z.high)
}
