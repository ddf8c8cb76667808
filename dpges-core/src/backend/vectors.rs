//! The vector instructions that kernels use, for both kinds of numbers.

use pulp::Simd;

use super::vector_math;
pub use super::vector_math::MOST;

/// The vectors of a number. [`Lanes`](super::lanes::Lanes) has the same as operators.
pub trait Vectors: Copy {
    type Vector<S: Simd>: Copy;
    type Mask<S: Simd>: Copy;

    /// Numbers in a vector: a divisor of [`MOST`].
    fn lane_count<S: Simd>() -> usize;
    fn splat_lanes<S: Simd>(simd: S, value: Self) -> Self::Vector<S>;
    fn load_lanes<S: Simd>(simd: S, values: &[Self]) -> Self::Vector<S>;
    fn store_lanes<S: Simd>(simd: S, values: &mut [Self], vector: Self::Vector<S>);
    fn add_lanes<S: Simd>(simd: S, a: Self::Vector<S>, b: Self::Vector<S>) -> Self::Vector<S>;
    fn sub_lanes<S: Simd>(simd: S, a: Self::Vector<S>, b: Self::Vector<S>) -> Self::Vector<S>;
    fn mul_lanes<S: Simd>(simd: S, a: Self::Vector<S>, b: Self::Vector<S>) -> Self::Vector<S>;
    /// a b + c, rounded once where the machine can.
    fn mul_add_lanes<S: Simd>(simd: S, a: Self::Vector<S>, b: Self::Vector<S>, c: Self::Vector<S>) -> Self::Vector<S>;
    fn div_lanes<S: Simd>(simd: S, a: Self::Vector<S>, b: Self::Vector<S>) -> Self::Vector<S>;
    fn sqrt_lanes<S: Simd>(simd: S, vector: Self::Vector<S>) -> Self::Vector<S>;
    fn min_lanes<S: Simd>(simd: S, a: Self::Vector<S>, b: Self::Vector<S>) -> Self::Vector<S>;
    fn max_lanes<S: Simd>(simd: S, a: Self::Vector<S>, b: Self::Vector<S>) -> Self::Vector<S>;
    fn at_least_lanes<S: Simd>(simd: S, a: Self::Vector<S>, b: Self::Vector<S>) -> Self::Mask<S>;
    fn below_lanes<S: Simd>(simd: S, a: Self::Vector<S>, b: Self::Vector<S>) -> Self::Mask<S>;
    fn both_lanes<S: Simd>(simd: S, a: Self::Mask<S>, b: Self::Mask<S>) -> Self::Mask<S>;
    fn either_lanes<S: Simd>(simd: S, a: Self::Mask<S>, b: Self::Mask<S>) -> Self::Mask<S>;
    fn any_lane<S: Simd>(simd: S, mask: Self::Mask<S>) -> bool;
    fn select_lanes<S: Simd>(simd: S, mask: Self::Mask<S>, a: Self::Vector<S>, b: Self::Vector<S>) -> Self::Vector<S>;
    fn sum_lanes<S: Simd>(simd: S, vector: Self::Vector<S>) -> Self;
    fn largest_lanes<S: Simd>(simd: S, vector: Self::Vector<S>) -> Self;
    /// e^x for x ≤ 0, within 2 units in the last place; 0 far below the cutoff.
    fn exp_nonpositive_lanes<S: Simd>(simd: S, vector: Self::Vector<S>) -> Self::Vector<S>;
    /// ln(1 + x) for x from 0 to 1, within 3 units in the last place.
    fn ln_1p_share_lanes<S: Simd>(simd: S, vector: Self::Vector<S>) -> Self::Vector<S>;
    /// e^x within 2 units in the last place, also where it is subnormal or infinite.
    fn exp_lanes<S: Simd>(simd: S, vector: Self::Vector<S>) -> Self::Vector<S>;
    /// ln x within 3 units in the last place; −∞ of 0, not a number below.
    fn ln_lanes<S: Simd>(simd: S, vector: Self::Vector<S>) -> Self::Vector<S>;
    /// sin x and cos x within 1e-7.
    fn sin_cos_lanes<S: Simd>(simd: S, vector: Self::Vector<S>) -> (Self::Vector<S>, Self::Vector<S>);
}

macro_rules! implement {
    (
        $number:ty, $vector:ident, $mask:ident, $count:ident, $slice:ident, $slice_mut:ident, $first_true:ident,
        $exp_nonpositive:path, $ln_1p_share:path, $exp:path, $ln:path, $sin_cos:path,
        $($function:ident($($argument:ident: $kind:ty),+) -> $result:ty = $instruction:ident;)+
    ) => {
        impl Vectors for $number {
            type Vector<S: Simd> = S::$vector;
            type Mask<S: Simd> = S::$mask;

            #[inline(always)]
            fn lane_count<S: Simd>() -> usize {
                const { assert!(MOST.is_multiple_of(S::$count)) };
                S::$count
            }

            #[inline(always)]
            fn load_lanes<S: Simd>(_: S, values: &[Self]) -> S::$vector {
                S::$slice(values).0[0]
            }

            #[inline(always)]
            fn store_lanes<S: Simd>(_: S, values: &mut [Self], vector: S::$vector) {
                S::$slice_mut(values).0[0] = vector;
            }

            #[inline(always)]
            fn any_lane<S: Simd>(simd: S, mask: S::$mask) -> bool {
                simd.$first_true(mask) < S::$count
            }

            $(
                #[inline(always)]
                fn $function<S: Simd>(simd: S, $($argument: $kind),+) -> $result {
                    simd.$instruction($($argument),+)
                }
            )+

            #[inline(always)]
            fn exp_nonpositive_lanes<S: Simd>(simd: S, vector: S::$vector) -> S::$vector {
                $exp_nonpositive(simd, vector)
            }

            #[inline(always)]
            fn ln_1p_share_lanes<S: Simd>(simd: S, vector: S::$vector) -> S::$vector {
                $ln_1p_share(simd, vector)
            }

            #[inline(always)]
            fn exp_lanes<S: Simd>(simd: S, vector: S::$vector) -> S::$vector {
                $exp(simd, vector)
            }

            #[inline(always)]
            fn ln_lanes<S: Simd>(simd: S, vector: S::$vector) -> S::$vector {
                $ln(simd, vector)
            }

            #[inline(always)]
            fn sin_cos_lanes<S: Simd>(simd: S, vector: S::$vector) -> (S::$vector, S::$vector) {
                $sin_cos(simd, vector)
            }
        }
    };
}

implement! {
    f32, f32s, m32s, F32_LANES, as_simd_f32s, as_mut_simd_f32s, first_true_m32s,
    vector_math::exp_nonpositive_f32, vector_math::ln_1p_share_f32, vector_math::exp_f32, vector_math::ln_f32, vector_math::sin_cos_f32,
    splat_lanes(value: f32) -> S::f32s = splat_f32s;
    add_lanes(a: S::f32s, b: S::f32s) -> S::f32s = add_f32s;
    sub_lanes(a: S::f32s, b: S::f32s) -> S::f32s = sub_f32s;
    mul_lanes(a: S::f32s, b: S::f32s) -> S::f32s = mul_f32s;
    mul_add_lanes(a: S::f32s, b: S::f32s, c: S::f32s) -> S::f32s = mul_add_e_f32s;
    div_lanes(a: S::f32s, b: S::f32s) -> S::f32s = div_f32s;
    sqrt_lanes(vector: S::f32s) -> S::f32s = sqrt_f32s;
    min_lanes(a: S::f32s, b: S::f32s) -> S::f32s = min_f32s;
    max_lanes(a: S::f32s, b: S::f32s) -> S::f32s = max_f32s;
    at_least_lanes(a: S::f32s, b: S::f32s) -> S::m32s = greater_than_or_equal_f32s;
    below_lanes(a: S::f32s, b: S::f32s) -> S::m32s = less_than_f32s;
    both_lanes(a: S::m32s, b: S::m32s) -> S::m32s = and_m32s;
    either_lanes(a: S::m32s, b: S::m32s) -> S::m32s = or_m32s;
    select_lanes(mask: S::m32s, a: S::f32s, b: S::f32s) -> S::f32s = select_f32s;
    sum_lanes(vector: S::f32s) -> f32 = reduce_sum_f32s;
    largest_lanes(vector: S::f32s) -> f32 = reduce_max_f32s;
}

implement! {
    f64, f64s, m64s, F64_LANES, as_simd_f64s, as_mut_simd_f64s, first_true_m64s,
    vector_math::exp_nonpositive_f64, vector_math::ln_1p_share_f64, vector_math::exp_f64, vector_math::ln_f64, vector_math::sin_cos_f64,
    splat_lanes(value: f64) -> S::f64s = splat_f64s;
    add_lanes(a: S::f64s, b: S::f64s) -> S::f64s = add_f64s;
    sub_lanes(a: S::f64s, b: S::f64s) -> S::f64s = sub_f64s;
    mul_lanes(a: S::f64s, b: S::f64s) -> S::f64s = mul_f64s;
    mul_add_lanes(a: S::f64s, b: S::f64s, c: S::f64s) -> S::f64s = mul_add_e_f64s;
    div_lanes(a: S::f64s, b: S::f64s) -> S::f64s = div_f64s;
    sqrt_lanes(vector: S::f64s) -> S::f64s = sqrt_f64s;
    min_lanes(a: S::f64s, b: S::f64s) -> S::f64s = min_f64s;
    max_lanes(a: S::f64s, b: S::f64s) -> S::f64s = max_f64s;
    at_least_lanes(a: S::f64s, b: S::f64s) -> S::m64s = greater_than_or_equal_f64s;
    below_lanes(a: S::f64s, b: S::f64s) -> S::m64s = less_than_f64s;
    both_lanes(a: S::m64s, b: S::m64s) -> S::m64s = and_m64s;
    either_lanes(a: S::m64s, b: S::m64s) -> S::m64s = or_m64s;
    select_lanes(mask: S::m64s, a: S::f64s, b: S::f64s) -> S::f64s = select_f64s;
    sum_lanes(vector: S::f64s) -> f64 = reduce_sum_f64s;
    largest_lanes(vector: S::f64s) -> f64 = reduce_max_f64s;
}
