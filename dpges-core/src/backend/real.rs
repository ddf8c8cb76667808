//! The two element types of the CPU kernels.

use burn::tensor::{DType, Element};

use super::vectors::Vectors;

/// `f32` for training, `f64` for gradient checks.
pub trait Real: num_traits::Float + Element + bytemuck::Pod + Send + Sync + std::iter::Sum + Vectors {
    const DTYPE: DType;
    const INFINITY: Self;

    fn of(value: f64) -> Self;

    fn as_f64(self) -> f64;

    /// e^self for self ≤ 0, within 2 units in the last place; 0 far below the cutoff. Loops over it vectorise.
    fn exp_nonpositive(self) -> Self;

    /// ln(1 + self) for self from 0 to 1, within 3 units in the last place. Loops over it vectorise.
    fn ln_1p_share(self) -> Self;
}

impl Real for f64 {
    const DTYPE: DType = DType::F64;
    const INFINITY: Self = f64::INFINITY;

    #[inline(always)]
    fn of(value: f64) -> Self {
        value
    }

    #[inline(always)]
    fn as_f64(self) -> f64 {
        self
    }

    #[inline(always)]
    fn exp_nonpositive(self) -> Self {
        self.exp()
    }

    #[inline(always)]
    fn ln_1p_share(self) -> Self {
        self.ln_1p()
    }
}

impl Real for f32 {
    const DTYPE: DType = DType::F32;
    const INFINITY: Self = f32::INFINITY;

    #[inline(always)]
    fn of(value: f64) -> Self {
        value as f32
    }

    #[inline(always)]
    fn as_f64(self) -> f64 {
        f64::from(self)
    }

    #[inline(always)]
    fn exp_nonpositive(self) -> Self {
        // x = n ln 2 + r, |r| ≤ ln 2 / 2. Adding 1.5 · 2²³ rounds to an integer and leaves it in the low bits.
        const ROUND: f32 = 12_582_912.0;
        const LN2_HIGH: f32 = 0.693_359_4;
        const LN2_LOW: f32 = -2.121_944_4e-4;
        let x = if self > -87.0 { self } else { -87.0 };
        let shifted = x * std::f32::consts::LOG2_E + ROUND;
        let n = shifted - ROUND;
        let r = (x - n * LN2_HIGH) - n * LN2_LOW;
        // Taylor coefficients, the last two adjusted for the interval
        let mut p = 1.388_888_9e-3 + r * 1.984_127e-4;
        p = p * r + 8.333_334e-3;
        p = p * r + 4.166_666_8e-2;
        p = p * r + 1.666_666_7e-1;
        p = p * r + 0.5;
        p = p * r + 1.0;
        p = p * r + 1.0;
        let exponent = shifted.to_bits().wrapping_sub(ROUND.to_bits()).wrapping_add(127) << 23;
        p * f32::from_bits(exponent)
    }

    #[inline(always)]
    fn ln_1p_share(self) -> Self {
        // ln(1 + x) = 2 artanh(x / (2 + x)), whose argument is at most 1/3
        let z = self / (2.0 + self);
        let squared = z * z;
        let mut p = 2.0 / 13.0 + squared * (2.0 / 15.0);
        for coefficient in [2.0 / 11.0, 2.0 / 9.0, 2.0 / 7.0, 2.0 / 5.0, 2.0 / 3.0, 2.0] {
            p = p * squared + coefficient;
        }
        p * z
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn f32_exponential_is_accurate_where_fragments_live_and_vanishes_below() {
        for step in 0..200_000 {
            let x = -(step as f32) * 1e-4;
            let exact = f64::from(x).exp();
            let relative = (f64::from(x.exp_nonpositive()) - exact).abs() / exact;
            assert!(relative < 2.5e-7, "exp({x}) off by {relative:e}");
        }
        assert!(f32::NEG_INFINITY.exp_nonpositive() < 1e-37);
        assert!((-1e30f32).exp_nonpositive() < 1e-37);
        assert_eq!(0f32.exp_nonpositive(), 1.0);
    }

    #[test]
    fn f32_logarithm_is_accurate_from_one_to_two() {
        for step in 1..=200_000 {
            let x = step as f32 / 200_000.0;
            for x in [x, x * 1e-6] {
                let exact = f64::from(x).ln_1p();
                let relative = (f64::from(x.ln_1p_share()) - exact).abs() / exact;
                assert!(relative < 3.6e-7, "ln(1 + {x}) off by {relative:e}");
            }
        }
        assert_eq!(0f32.ln_1p_share(), 0.0);
    }
}
