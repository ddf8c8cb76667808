//! CPU kernels: one row at a time.

use burn::backend::TensorMetadata;
use burn::backend::tensor::FloatTensor;
use rayon::prelude::*;

use super::{HarmonicsBackwardOps, HarmonicsOps};
use crate::backend::host::{self, Host, for_each_cpu_backend, with_real};
use crate::backend::real::Real;
use crate::math::row;
use crate::ops::colour::cpu::model::{direction, harmonics};
use crate::scene::SH_C0;

const MIN_ROWS: usize = 512;

fn forward<T: Real>(base: &[T], detail: &[T], positions: &[T], centre: [f64; 3]) -> Vec<T> {
    let (width, centre) = (detail.len().checked_div(base.len()).unwrap_or(0), centre.map(T::of));
    let value = |i: usize| {
        let d = direction(row(positions, i), centre);
        let higher = detail[i * width..(i + 1) * width].iter().zip(harmonics(d)).map(|(&k, y)| k * y);
        T::of(SH_C0) * base[i] + higher.sum::<T>()
    };
    (0..base.len()).into_par_iter().with_min_len(MIN_ROWS).map(value).collect()
}

/// Gradients with respect to base and detail.
fn backward<T: Real>(positions: &[T], grad: &[T], centre: [f64; 3], coefficients: usize) -> (Vec<T>, Vec<T>) {
    let (width, centre) = (coefficients - 1, centre.map(T::of));
    let base = grad.iter().map(|&g| g * T::of(SH_C0)).collect();
    let mut detail = vec![T::zero(); grad.len() * width];
    if width > 0 {
        detail.par_chunks_mut(width).with_min_len(MIN_ROWS).enumerate().for_each(|(i, out)| {
            let d = direction(row(positions, i), centre);
            out.iter_mut().zip(harmonics(d)).for_each(|(out, y)| *out = grad[i] * y);
        });
    }
    (base, detail)
}

fn harmonics_on<B: Host>(
    base: &FloatTensor<B>,
    detail: &FloatTensor<B>,
    positions: &FloatTensor<B>,
    centre: [f64; 3],
) -> FloatTensor<B> {
    let (count, device) = (host::rows(base), base.device());
    with_real!(base.dtype(), T => {
        let (base, detail, positions) = (host::floats::<B, T>(base), host::floats::<B, T>(detail), host::floats::<B, T>(positions));
        let out = forward(&base, &detail, &positions, centre);
        host::float_tensor::<B, T, 2>(out, [count, 1], &device)
    })
}

fn harmonics_backward_on<B: Host>(
    positions: &FloatTensor<B>,
    grad: &FloatTensor<B>,
    centre: [f64; 3],
    coefficients: usize,
) -> (FloatTensor<B>, FloatTensor<B>) {
    let (count, device) = (host::rows(grad), grad.device());
    with_real!(grad.dtype(), T => {
        let (positions, grad) = (host::floats::<B, T>(positions), host::floats::<B, T>(grad));
        let (base, detail) = backward(&positions, &grad, centre, coefficients);
        (
            host::float_tensor::<B, T, 2>(base, [count, 1], &device),
            host::float_tensor::<B, T, 2>(detail, [count, coefficients - 1], &device),
        )
    })
}

macro_rules! implement {
    ($backend:ty) => {
        impl HarmonicsOps for $backend {
            fn harmonics(
                base: FloatTensor<Self>,
                detail: FloatTensor<Self>,
                positions: FloatTensor<Self>,
                centre: [f64; 3],
            ) -> FloatTensor<Self> {
                harmonics_on::<Self>(&base, &detail, &positions, centre)
            }
        }

        impl HarmonicsBackwardOps for $backend {
            fn harmonics_backward(
                positions: FloatTensor<Self>,
                grad: FloatTensor<Self>,
                centre: [f64; 3],
                coefficients: usize,
            ) -> (FloatTensor<Self>, FloatTensor<Self>) {
                harmonics_backward_on::<Self>(&positions, &grad, centre, coefficients)
            }
        }
    };
}
for_each_cpu_backend!(implement);
