//! The two element types of the CPU kernels.

use burn::tensor::{DType, Element};
use pulp::Scalar;

use super::vectors::Vectors;

/// `f32` for training, `f64` for gradient checks.
pub trait Real: num_traits::Float + Element + bytemuck::Pod + Send + Sync + std::iter::Sum + Vectors {
    const DTYPE: DType;
    const INFINITY: Self;

    fn of(value: f64) -> Self;

    fn as_f64(self) -> f64;

    /// e^self for self ≤ 0, within 2 units in the last place; 0 far below the cutoff. Loops over it vectorise.
    #[inline(always)]
    fn exp_nonpositive(self) -> Self {
        alone(Self::exp_nonpositive_lanes, self)
    }

    /// ln(1 + self) for self from 0 to 1, within 3 units in the last place. Loops over it vectorise.
    #[inline(always)]
    fn ln_1p_share(self) -> Self {
        alone(Self::ln_1p_share_lanes, self)
    }
}

/// A function of vectors, of one number.
#[inline(always)]
fn alone<T: Vectors>(function: impl Fn(Scalar, T::Vector<Scalar>) -> T::Vector<Scalar>, value: T) -> T {
    let simd = Scalar::new();
    T::sum_lanes(simd, function(simd, T::splat_lanes(simd, value)))
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
}
