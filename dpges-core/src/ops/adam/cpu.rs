//! CPU kernel: one pass over parameter, moments and gradient.

use burn::backend::TensorMetadata;
use burn::backend::tensor::FloatTensor;
use burn::tensor::TensorData;
use rayon::prelude::*;

use super::{AdamOps, AdamOutput, AdamStep};
use crate::backend::host::{self, Host, with_real};
use crate::backend::real::Real;
use crate::backend::vectorised::vectorised;

const CHUNK: usize = 1 << 14;

fn step_in_place<T: Real>(parameter: &mut [T], moment_1: &mut [T], moment_2: &mut [T], grad: &[T], step: &AdamStep) {
    let [rate, correction] = step.corrected().map(T::of);
    let (beta_1, beta_2, epsilon) = (T::of(step.beta_1), T::of(step.beta_2), T::of(step.epsilon));
    // subtracted in f64: from 0.999 as an f32, 1 − β would be off by 3e-5 of itself
    let (new_1, new_2) = (T::of(1.0 - step.beta_1), T::of(1.0 - step.beta_2));
    parameter
        .par_chunks_mut(CHUNK)
        .zip(moment_1.par_chunks_mut(CHUNK))
        .zip(moment_2.par_chunks_mut(CHUNK))
        .zip(grad.par_chunks(CHUNK))
        .for_each(|(((parameter, moment_1), moment_2), grad)| {
            vectorised(
                #[inline(always)]
                || {
                    for (((p, m), v), &g) in parameter.iter_mut().zip(moment_1).zip(moment_2).zip(grad) {
                        *m = beta_1 * *m + new_1 * g;
                        *v = beta_2 * *v + new_2 * g * g;
                        *p = *p - rate * *m / (v.sqrt() * correction + epsilon);
                    }
                },
            );
        });
}

impl<B: Host> AdamOps for B {
    fn adam_step(
        parameter: FloatTensor<B>,
        moment_1: FloatTensor<B>,
        moment_2: FloatTensor<B>,
        grad: FloatTensor<B>,
        gate: FloatTensor<B>,
        step: AdamStep,
    ) -> AdamOutput<B> {
        let (shape, device) = (parameter.shape(), parameter.device());
        with_real!(parameter.dtype(), T => {
            // closed in a step with values that are not finite, which the moments would keep for good
            if host::floats::<B, T>(&gate)[0] != T::of(1.0) {
                return AdamOutput { parameter, moment_1, moment_2 };
            }
            let [mut parameter, mut moment_1, mut moment_2] = [parameter, moment_1, moment_2].map(host::take_floats::<B, T>);
            step_in_place(&mut parameter, &mut moment_1, &mut moment_2, &host::floats::<B, T>(&grad), &step);
            let [parameter, moment_1, moment_2] =
                [parameter, moment_1, moment_2].map(|values| B::float_from_data(TensorData::new(values, shape.clone()), &device));
            AdamOutput { parameter, moment_1, moment_2 }
        })
    }
}
