//! CPU kernel: one pass over parameter, moments and gradient.

use burn::backend::TensorMetadata;
use burn::backend::tensor::FloatTensor;
use burn::tensor::TensorData;
use rayon::prelude::*;

use super::{AdamOps, AdamPair, AdamStep, AdamTensors};
use crate::host::{self, Host, for_each_cpu_backend, with_real};
use crate::real::Real;
use crate::simd::vectorised;

const CHUNK: usize = 1 << 14;

fn step_in_place<T: Real>(value: &mut [T], moments: &mut [T], gradient: &[T], learning_rate: f64, step: &AdamStep) {
    let [rate, correction] = step.corrected(learning_rate).map(T::of);
    let (beta_1, beta_2, epsilon) = (T::of(step.beta_1), T::of(step.beta_2), T::of(step.epsilon));
    let (new_1, new_2) = (T::of(1.0 - step.beta_1), T::of(1.0 - step.beta_2));
    let (moment_1, moment_2) = moments.split_at_mut(value.len());
    value
        .par_chunks_mut(CHUNK)
        .zip(moment_1.par_chunks_mut(CHUNK))
        .zip(moment_2.par_chunks_mut(CHUNK))
        .zip(gradient.par_chunks(CHUNK))
        .for_each(|(((value, moment_1), moment_2), gradient)| {
            vectorised(
                #[inline(always)]
                || {
                    for (((p, m), v), &g) in value.iter_mut().zip(moment_1).zip(moment_2).zip(gradient) {
                        *m = beta_1 * *m + new_1 * g;
                        *v = beta_2 * *v + new_2 * g * g;
                        *p = *p - rate * *m / (v.sqrt() * correction + epsilon);
                    }
                },
            );
        });
}

/// One parameter after a step that the gate lets through.
fn stepped<B: Host, T: Real>(
    AdamTensors { value, moments, gradient }: AdamTensors<B>,
    learning_rate: f64,
    step: &AdamStep,
) -> AdamTensors<B> {
    let device = value.device();
    let shapes = [value.shape(), moments.shape()];
    let [mut value, mut moments] = [value, moments].map(host::take_floats::<B, T>);
    step_in_place(&mut value, &mut moments, &host::floats::<B, T>(&gradient), learning_rate, step);
    let [value_shape, moments_shape] = shapes;
    let value = B::float_from_data(TensorData::new(value, value_shape), &device);
    let moments = B::float_from_data(TensorData::new(moments, moments_shape), &device);
    AdamTensors { value, moments, gradient }
}

fn adam_on<B: Host>(
    AdamPair { first, second }: AdamPair<B>,
    gate: &FloatTensor<B>,
    (first_rate, second_rate): (f64, Option<f64>),
    step: &AdamStep,
) -> AdamPair<B> {
    with_real!(first.value.dtype(), T => {
        if host::floats::<B, T>(gate)[0] != T::of(1.0) {
            return AdamPair { first, second };
        }
        let first = stepped::<B, T>(first, first_rate, step);
        let second = match second_rate {
            Some(rate) => stepped::<B, T>(second, rate, step),
            None => second,
        };
        AdamPair { first, second }
    })
}

macro_rules! implement {
    ($backend:ty) => {
        impl AdamOps for $backend {
            fn adam_step(
                pair: AdamPair<Self>,
                gate: FloatTensor<Self>,
                learning_rates: (f64, Option<f64>),
                step: AdamStep,
            ) -> AdamPair<Self> {
                adam_on::<Self>(pair, &gate, learning_rates, &step)
            }
        }
    };
}
for_each_cpu_backend!(implement);
