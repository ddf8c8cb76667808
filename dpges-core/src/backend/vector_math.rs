//! Exponentials, logarithms, sines and cosines of vectors: polynomials in f32, the library's one by one in f64.

use pulp::Simd;

/// Most numbers in a vector: of 512 bits, in f32.
pub const MOST: usize = 16;

/// 1.5 · 2²³: added, it rounds to an integer and leaves that in the low bits.
const ROUND: f32 = 12_582_912.0;
/// ln 2 in two parts: the product of the first and an exponent is exact.
const LN_2: [f32; 2] = [0.693_359_4, -2.121_944_4e-4];
/// π / 2 in three parts: the products of the first two and a number below 2¹³ are exact.
const HALF_PI: [f32; 3] = [1.570_312_5, 4.837_513e-4, 7.549_79e-8];
/// Largest argument for which those parts suffice.
const LARGEST_ANGLE: f32 = 8192.0;

#[inline(always)]
pub fn exp_nonpositive_f32<S: Simd>(simd: S, vector: S::f32s) -> S::f32s {
    let all = |value: f32| simd.splat_f32s(value);
    // not a number becomes the smallest
    let x = simd.select_f32s(simd.greater_than_or_equal_f32s(vector, all(-87.0)), vector, all(-87.0));
    let (shifted, p) = reduced_exp(simd, x);
    simd.mul_f32s(p, power_of_two(simd, shifted))
}

#[inline(always)]
pub fn exp_nonpositive_f64<S: Simd>(_: S, vector: S::f64s) -> S::f64s {
    one_by_one::<S>(vector, f64::exp)
}

#[inline(always)]
pub fn ln_1p_share_f32<S: Simd>(simd: S, vector: S::f32s) -> S::f32s {
    // ln(1 + x) = 2 artanh(x / (2 + x)), whose argument is at most 1/3
    let all = |value: f32| simd.splat_f32s(value);
    let z = simd.div_f32s(vector, simd.add_f32s(all(2.0), vector));
    let squared = simd.mul_f32s(z, z);
    let mut p = simd.mul_add_e_f32s(squared, all(2.0 / 15.0), all(2.0 / 13.0));
    for coefficient in [2.0 / 11.0, 2.0 / 9.0, 2.0 / 7.0, 2.0 / 5.0, 2.0 / 3.0, 2.0] {
        p = simd.mul_add_e_f32s(p, squared, all(coefficient));
    }
    simd.mul_f32s(p, z)
}

#[inline(always)]
pub fn ln_1p_share_f64<S: Simd>(_: S, vector: S::f64s) -> S::f64s {
    one_by_one::<S>(vector, f64::ln_1p)
}

/// n + [`ROUND`] and e^r, with x = n ln 2 + r and |r| ≤ ln 2 / 2.
#[inline(always)]
fn reduced_exp<S: Simd>(simd: S, x: S::f32s) -> (S::f32s, S::f32s) {
    let all = |value: f32| simd.splat_f32s(value);
    let shifted = simd.mul_add_e_f32s(x, all(std::f32::consts::LOG2_E), all(ROUND));
    let n = simd.sub_f32s(shifted, all(ROUND));
    let r = simd.mul_add_e_f32s(n, all(-LN_2[0]), x);
    let r = simd.mul_add_e_f32s(n, all(-LN_2[1]), r);
    // Taylor coefficients, the last two adjusted for the interval
    let mut p = simd.mul_add_e_f32s(r, all(1.984_127e-4), all(1.388_888_9e-3));
    for coefficient in [8.333_334e-3, 4.166_666_8e-2, 1.666_666_7e-1, 0.5, 1.0, 1.0] {
        p = simd.mul_add_e_f32s(p, r, all(coefficient));
    }
    (shifted, p)
}

/// 2^n from n + [`ROUND`], for n from −126 to 127.
#[inline(always)]
fn power_of_two<S: Simd>(simd: S, shifted: S::f32s) -> S::f32s {
    let exponent = simd.sub_u32s(simd.transmute_u32s_f32s(shifted), simd.splat_u32s(ROUND.to_bits() - 127));
    simd.transmute_f32s_u32s(simd.wrapping_dyn_shl_u32s(exponent, simd.splat_u32s(23)))
}

#[inline(always)]
pub fn exp_f32<S: Simd>(simd: S, vector: S::f32s) -> S::f32s {
    let all = |value: f32| simd.splat_f32s(value);
    // beyond these the result is 0 and infinite
    let x = simd.min_f32s(simd.max_f32s(vector, all(-104.0)), all(89.0));
    let (shifted, p) = reduced_exp(simd, x);
    // 2^n in two factors: for n above 127 it is infinite where the result is not, below −126 subnormal
    let half = simd.mul_add_e_f32s(simd.sub_f32s(shifted, all(ROUND)), all(0.5), all(ROUND));
    let rest = simd.add_f32s(simd.sub_f32s(shifted, half), all(ROUND));
    let result = simd.mul_f32s(simd.mul_f32s(p, power_of_two(simd, half)), power_of_two(simd, rest));
    simd.select_f32s(simd.equal_f32s(vector, vector), result, vector)
}

#[inline(always)]
pub fn exp_f64<S: Simd>(_: S, vector: S::f64s) -> S::f64s {
    one_by_one::<S>(vector, f64::exp)
}

#[inline(always)]
pub fn ln_f32<S: Simd>(simd: S, vector: S::f32s) -> S::f32s {
    let all = |value: f32| simd.splat_f32s(value);
    // subnormal numbers have no exponent of their own
    let is_small = simd.less_than_f32s(vector, all(f32::MIN_POSITIVE));
    let x = simd.select_f32s(is_small, simd.mul_f32s(vector, all(8_388_608.0)), vector);
    // x = 2^n m, m between the roots of 1/2 and 2: the bits above those of √½ count n
    let root = std::f32::consts::FRAC_1_SQRT_2.to_bits();
    let above = simd.sub_u32s(simd.transmute_u32s_f32s(x), simd.splat_u32s(root));
    // counted from −127, so that no bit is lost, and read by [`ROUND`], whose low bits they are
    let biased = simd.add_u32s(above, simd.splat_u32s(127 << 23));
    let n = simd.wrapping_dyn_shr_u32s(biased, simd.splat_u32s(23));
    let mantissa = simd.sub_u32s(biased, simd.wrapping_dyn_shl_u32s(n, simd.splat_u32s(23)));
    let m = simd.transmute_f32s_u32s(simd.add_u32s(mantissa, simd.splat_u32s(root)));
    let n = simd.transmute_f32s_u32s(simd.add_u32s(n, simd.splat_u32s(ROUND.to_bits())));
    let bias = simd.select_f32s(is_small, all(ROUND + 127.0 + 23.0), all(ROUND + 127.0));
    let n = simd.sub_f32s(n, bias);
    // ln m = f − s (f − R), f = m − 1, s = f / (2 + f): the rounding of s matters little
    let f = simd.sub_f32s(m, all(1.0));
    let s = simd.div_f32s(f, simd.add_f32s(all(2.0), f));
    let squared = simd.mul_f32s(s, s);
    let mut r = simd.mul_add_e_f32s(squared, all(2.0 / 11.0), all(2.0 / 9.0));
    for coefficient in [2.0 / 7.0, 2.0 / 5.0, 2.0 / 3.0] {
        r = simd.mul_add_e_f32s(r, squared, all(coefficient));
    }
    let r = simd.mul_f32s(r, squared);
    let rest = simd.mul_add_e_f32s(n, all(LN_2[1]), simd.mul_f32s(s, simd.sub_f32s(r, f)));
    let result = simd.add_f32s(simd.mul_f32s(n, all(LN_2[0])), simd.add_f32s(f, rest));
    let result = simd.select_f32s(simd.less_than_f32s(vector, all(f32::INFINITY)), result, vector);
    let beyond = simd.select_f32s(simd.equal_f32s(vector, all(0.0)), all(f32::NEG_INFINITY), all(f32::NAN));
    simd.select_f32s(simd.less_than_f32s(all(0.0), vector), result, beyond)
}

#[inline(always)]
pub fn ln_f64<S: Simd>(_: S, vector: S::f64s) -> S::f64s {
    one_by_one::<S>(vector, f64::ln)
}

#[inline(always)]
pub fn sin_cos_f32<S: Simd>(simd: S, vector: S::f32s) -> (S::f32s, S::f32s) {
    let all = |value: f32| simd.splat_f32s(value);
    let is_small = simd.less_than_f32s(simd.abs_f32s(vector), all(LARGEST_ANGLE));
    if simd.first_true_m32s(simd.not_m32s(is_small)) < S::F32_LANES {
        let [mut sines, mut cosines] = [[0.0; MOST]; 2];
        S::as_mut_simd_f32s(&mut sines).0[0] = vector;
        for (sine, cosine) in sines.iter_mut().zip(&mut cosines) {
            (*sine, *cosine) = sine.sin_cos();
        }
        return (S::as_simd_f32s(&sines).0[0], S::as_simd_f32s(&cosines).0[0]);
    }
    // x = n π/2 + r, |r| ≤ π/4
    let shifted = simd.mul_add_e_f32s(vector, all(std::f32::consts::FRAC_2_PI), all(ROUND));
    let n = simd.sub_f32s(shifted, all(ROUND));
    let mut r = vector;
    for part in HALF_PI {
        r = simd.mul_add_e_f32s(n, all(-part), r);
    }
    // Taylor coefficients: the next would change less than the last place
    let squared = simd.mul_f32s(r, r);
    let mut sine = simd.mul_add_e_f32s(squared, all(1.0 / 362_880.0), all(-1.0 / 5040.0));
    for coefficient in [1.0 / 120.0, -1.0 / 6.0] {
        sine = simd.mul_add_e_f32s(sine, squared, all(coefficient));
    }
    let sine = simd.mul_add_e_f32s(simd.mul_f32s(sine, squared), r, r);
    let mut cosine = simd.mul_add_e_f32s(squared, all(-1.0 / 3_628_800.0), all(1.0 / 40_320.0));
    for coefficient in [-1.0 / 720.0, 1.0 / 24.0, -0.5, 1.0] {
        cosine = simd.mul_add_e_f32s(cosine, squared, all(coefficient));
    }
    // a quarter turn exchanges them, and half a turn changes their signs
    let quarters = simd.transmute_u32s_f32s(shifted);
    let one = simd.splat_u32s(1);
    let is_even = simd.less_than_u32s(simd.and_u32s(quarters, one), one);
    let signed = {
        #[inline(always)]
        |value: S::f32s, halves: S::u32s| {
            let sign = simd.wrapping_dyn_shl_u32s(simd.and_u32s(halves, simd.splat_u32s(2)), simd.splat_u32s(30));
            simd.transmute_f32s_u32s(simd.xor_u32s(simd.transmute_u32s_f32s(value), sign))
        }
    };
    (
        signed(simd.select_f32s(is_even, sine, cosine), quarters),
        signed(simd.select_f32s(is_even, cosine, sine), simd.add_u32s(quarters, one)),
    )
}

#[inline(always)]
pub fn sin_cos_f64<S: Simd>(_: S, vector: S::f64s) -> (S::f64s, S::f64s) {
    (one_by_one::<S>(vector, f64::sin), one_by_one::<S>(vector, f64::cos))
}

#[inline(always)]
fn one_by_one<S: Simd>(vector: S::f64s, function: impl Fn(f64) -> f64) -> S::f64s {
    let mut values = [0.0; MOST];
    S::as_mut_simd_f64s(&mut values).0[0] = vector;
    S::as_simd_f64s(&values.map(function)).0[0]
}

#[cfg(test)]
mod tests {
    use pulp::WithSimd;

    use super::*;
    use crate::backend::vectorised::vectorised;

    /// Results of e^x, ln x, sin x and cos x.
    struct All<'a>(&'a [f32]);

    impl WithSimd for All<'_> {
        type Output = [Vec<f32>; 4];

        #[inline(always)]
        fn with_simd<S: Simd>(self, simd: S) -> Self::Output {
            let mut out = [(); 4].map(|()| vec![0.0; self.0.len()]);
            for (at, values) in self.0.chunks_exact(S::F32_LANES).enumerate() {
                let vector = S::as_simd_f32s(values).0[0];
                let (sine, cosine) = sin_cos_f32(simd, vector);
                for (out, of) in out.iter_mut().zip([exp_f32(simd, vector), ln_f32(simd, vector), sine, cosine]) {
                    S::as_mut_simd_f32s(&mut out[at * S::F32_LANES..]).0[0] = of;
                }
            }
            out
        }
    }

    /// Difference in units in the last place of the exact value, at least of the smallest normal number.
    fn units(found: f32, exact: f64) -> f64 {
        let place = f64::from((exact.abs() as f32).max(f32::MIN_POSITIVE)).log2().floor() - 23.0;
        (f64::from(found) - exact).abs() / place.exp2()
    }

    /// The largest of `error` over `arguments`, with its argument.
    fn worst(
        arguments: &[f32],
        which: usize,
        error: impl Fn(f32, f64) -> f64,
        exact: impl Fn(f64) -> f64,
    ) -> (f64, f32) {
        let found = vectorised(All(arguments));
        let errors = arguments.iter().zip(&found[which]).map(|(&x, &found)| (error(found, exact(f64::from(x))), x));
        errors.fold((0.0, 0.0), |worst, this| if this.0 > worst.0 || this.0.is_nan() { this } else { worst })
    }

    #[test]
    fn exponentials_and_logarithms_are_accurate_everywhere() {
        // down to the last subnormal result, and up to the largest
        let arguments: Vec<f32> = (0..64_000).map(|i| -103.2 + 191.9 * i as f32 / 64_000.0).collect();
        let (error, at) = worst(&arguments, 0, units, f64::exp);
        assert!(error < 1.5, "exp({at}) is {error} units off");
        // every exponent, subnormal ones included, and close to 1
        let near_one = (0..16_000).map(|i| 0.5 + i as f32 / 10_000.0);
        let arguments: Vec<f32> = (0..64_000).map(|i| f32::from_bits(1 + 33_423 * i)).chain(near_one).collect();
        let (error, at) = worst(&arguments, 1, units, f64::ln);
        assert!(error < 2.0, "ln({at}) is {error} units off");
    }

    #[test]
    fn sines_and_cosines_are_accurate_for_small_and_large_angles() {
        let absolute = |found: f32, exact: f64| (f64::from(found) - exact).abs();
        for (which, exact) in [(2, f64::sin as fn(f64) -> f64), (3, f64::cos)] {
            for (unit, count) in [(2e-4, 40_000), (0.2, 40_000), (1e33, 32)] {
                let arguments: Vec<f32> = (-count..count).map(|i| i as f32 * unit).collect();
                let (error, at) = worst(&arguments, which, absolute, exact);
                assert!(error < 1e-7, "function {which} of {at} is {error} off");
            }
        }
        // also relatively where the sine is small
        let arguments: Vec<f32> = (0..4_000).map(|i| 10f32.powf(-0.01 * i as f32)).collect();
        let (error, at) = worst(&arguments, 2, units, f64::sin);
        assert!(error < 1.5, "sin({at}) is {error} units off");
    }

    #[test]
    fn what_is_no_number_and_what_is_infinite_stay_so() {
        let special = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 0.0, -0.0, -1.0, 88.8, -104.0];
        let [exp, ln, sine, cosine] = vectorised(All(&special.repeat(2)));
        assert!(exp[0].is_nan() && ln[0].is_nan() && sine[0].is_nan() && cosine[0].is_nan());
        assert_eq!(exp[1..5], [f32::INFINITY, 0.0, 1.0, 1.0]);
        assert_eq!(exp[6..8], [f32::INFINITY, 0.0]);
        assert_eq!(ln[1..2], [f32::INFINITY]);
        assert_eq!(ln[3..5], [f32::NEG_INFINITY; 2]);
        assert!(ln[2].is_nan() && ln[5].is_nan());
        assert!(sine[1].is_nan() && cosine[2].is_nan());
        assert_eq!((sine[3], cosine[3], sine[4], cosine[4]), (0.0, 1.0, 0.0, 1.0));
    }
}
