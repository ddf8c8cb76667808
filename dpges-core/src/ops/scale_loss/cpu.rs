//! CPU kernels: one task per run of surfels.

use burn::backend::TensorMetadata;
use burn::backend::tensor::FloatTensor;
use rayon::prelude::*;

use super::autodiff::ScaleLossState;
use super::{LINEAR_FROM, ScaleLossOps, ScaleLossOutput};
use crate::backend::host::{self, Host, with_real};
use crate::backend::real::Real;
use crate::backend::tape::BackwardState;

/// Log-scales of a task.
const CHUNK: usize = 1 << 13;

/// Sum of `of` over chunks of `log_scales`, in their order.
fn sum<T: Real>(log_scales: &[T], of: impl Fn(&[T]) -> T + Send + Sync) -> T {
    log_scales.par_chunks(CHUNK).map(of).collect::<Vec<T>>().into_iter().sum()
}

/// Logarithm of the mean scale.
fn log_mean<T: Real>(log_scales: &[T]) -> T {
    let largest = log_scales.iter().fold(T::neg_infinity(), |largest, &value| largest.max(value));
    // relative to the largest, so that no exponential overflows in a world of any size
    let total = sum(log_scales, |chunk| chunk.iter().map(|&value| (value - largest).exp()).sum());
    largest + (total / T::of(log_scales.len() as f64)).ln()
}

/// exp(x) and its derivative, continued by the tangent.
fn cost<T: Real>(x: T) -> [T; 2] {
    // e⁸⁸ is about the largest f32: one huge surfel would spoil the loss of all
    let clamped = x.min(T::of(LINEAR_FROM));
    let slope = clamped.exp();
    [slope * (x - clamped + T::one()), slope]
}

/// The two scales of a surfel over the mean scale, and the mean of these.
fn ratios<T: Real>(log_scales: &[T], log_mean: T) -> ([T; 2], T) {
    let ratios = [0, 1].map(|axis| (log_scales[axis] - log_mean).exp());
    (ratios, T::of(0.5) * (ratios[0] + ratios[1]))
}

/// The mean cost of a surfel.
fn value<T: Real>(log_scales: &[T], log_mean: T) -> T {
    let of_surfel = |scales: &[T]| cost(ratios(scales, log_mean).1)[0];
    sum(log_scales, |chunk| chunk.chunks_exact(2).map(of_surfel).sum()) / T::of((log_scales.len() / 2) as f64)
}

fn backward<T: Real>(log_scales: &[T], log_mean: T, grad: T) -> Vec<T> {
    let share = grad * T::of(0.5) / T::of((log_scales.len() / 2) as f64);
    let of_surfel = |scales: &[T]| {
        let (ratios, x) = ratios(scales, log_mean);
        ratios.map(|ratio| share * cost(x)[1] * ratio)
    };
    log_scales.par_chunks_exact(2).with_min_len(CHUNK).flat_map_iter(of_surfel).collect()
}

impl<B: Host> ScaleLossOps for B {
    fn scale_loss(log_scales: FloatTensor<B>, weight: f64) -> ScaleLossOutput<B> {
        with_real!(log_scales.dtype(), T => {
            let values = host::floats::<B, T>(&log_scales);
            let log_mean = log_mean(&values);
            let value = value(&values, log_mean);
            let [weighted, value, log_mean] = [value * T::of(weight), value, log_mean]
                .map(|number| host::float_tensor::<B, T, 1>(vec![number], [1], &log_scales.device()));
            ScaleLossOutput { weighted, value, log_mean }
        })
    }
}

impl<B: Host> BackwardState<B, 1> for ScaleLossState<B> {
    fn backward(self, grad: FloatTensor<B>) -> [Option<FloatTensor<B>>; 1] {
        with_real!(grad.dtype(), T => {
            let [log_scales, log_mean, grad] = [&self.log_scales, &self.log_mean, &grad].map(host::floats::<B, T>);
            let out = backward(&log_scales, log_mean[0], grad[0] * T::of(self.weight));
            [Some(host::float_tensor::<B, T, 2>(out, [log_scales.len() / 2, 2], &self.log_scales.device()))]
        })
    }
}
