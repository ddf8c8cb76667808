//! CPU kernels: one row at a time.

use burn::backend::TensorMetadata;
use burn::backend::tensor::FloatTensor;
use rayon::prelude::*;

use super::HarmonicsOps;
use super::autodiff::HarmonicsState;
use crate::backend::host::{self, Host, with_real};
use crate::backend::real::Real;
use crate::backend::tape::BackwardState;
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
fn backward<T: Real>(positions: &[T], grad: &[T], centre: [f64; 3], width: usize) -> (Vec<T>, Vec<T>) {
    let centre = centre.map(T::of);
    // no gradient to positions: directions carry none
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

impl<B: Host> HarmonicsOps for B {
    fn harmonics(
        base: FloatTensor<B>,
        detail: FloatTensor<B>,
        positions: FloatTensor<B>,
        centre: [f64; 3],
    ) -> FloatTensor<B> {
        let (count, device) = (host::rows(&base), base.device());
        with_real!(base.dtype(), T => {
            let [base, detail, positions] = [&base, &detail, &positions].map(host::floats::<B, T>);
            let out = forward(&base, &detail, &positions, centre);
            host::float_tensor::<B, T, 2>(out, [count, 1], &device)
        })
    }
}

impl<B: Host> BackwardState<B, 2> for HarmonicsState<B> {
    fn backward(self, grad: FloatTensor<B>) -> [Option<FloatTensor<B>>; 2] {
        let (count, device) = (host::rows(&grad), grad.device());
        with_real!(grad.dtype(), T => {
            let [positions, grad] = [&self.positions, &grad].map(host::floats::<B, T>);
            let (base, detail) = backward(&positions, &grad, self.centre, self.higher);
            [(base, 1), (detail, self.higher)]
                .map(|(values, width)| Some(host::float_tensor::<B, T, 2>(values, [count, width], &device)))
        })
    }
}
