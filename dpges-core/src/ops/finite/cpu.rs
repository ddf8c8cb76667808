//! CPU kernel.

use burn::backend::TensorMetadata;
use burn::backend::tensor::{FloatTensor, IntTensor};
use rayon::prelude::*;

use super::FiniteOps;
use crate::host::{self, Host, for_each_cpu_backend, with_real};
use crate::real::Real;

const CHUNK: usize = 1 << 14;

fn first_non_finite<T: Real>(values: &[T]) -> i32 {
    // 0 · x is 0 for every finite x and NaN otherwise: one vectorised sum per chunk
    let suspicious = |chunk: &[T]| !chunk.iter().fold(T::zero(), |sum, &x| sum + x * T::zero()).is_finite();
    let chunk = values.par_chunks(CHUNK).position_first(suspicious);
    let within =
        |chunk: usize| values[chunk * CHUNK..].iter().position(|x| !x.is_finite()).map(|at| chunk * CHUNK + at);
    chunk.and_then(within).map_or(-1, |at| i32::try_from(at).unwrap_or(i32::MAX))
}

fn first_non_finite_on<B: Host>(tensor: &FloatTensor<B>) -> IntTensor<B> {
    let position = with_real!(tensor.dtype(), T => first_non_finite(&host::floats::<B, T>(tensor)));
    host::int_tensor::<B, 1>(vec![position], [1], &tensor.device())
}

macro_rules! implement {
    ($backend:ty) => {
        impl FiniteOps for $backend {
            fn first_non_finite(tensor: FloatTensor<Self>) -> IntTensor<Self> {
                first_non_finite_on::<Self>(&tensor)
            }
        }
    };
}
for_each_cpu_backend!(implement);
