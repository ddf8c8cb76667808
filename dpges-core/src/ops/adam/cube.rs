//! GPU kernel: one unit per place in both parameters, in place where nothing else shares the buffers.

use burn::backend::TensorMetadata;
use burn::backend::tensor::FloatTensor;
use burn_cubecl::CubeBackend;
use burn_cubecl::tensor::CubeTensor;
use cubecl::prelude::*;

use super::{AdamOps, AdamPair, AdamStep, AdamTensors};
use crate::gpu::launch::{buffer, cube_dim, empty_f32, floats, units};

#[derive(CubeType, CubeLaunch, Clone, Copy)]
#[expand(derive(Clone, Copy))]
struct Rates {
    /// Of each parameter: the learning rate over the bias correction of the first moment.
    first_rate: f32,
    second_rate: f32,
    /// Reciprocal root of the bias correction of the second moment.
    correction: f32,
    beta_1: f32,
    beta_2: f32,
    /// 1 − β1 and 1 − β2, rounded once.
    new_1: f32,
    new_2: f32,
    epsilon: f32,
    /// Numbers of each parameter.
    first_count: u32,
    second_count: u32,
}

/// Steps the number at this place of a parameter if it has so many.
#[cube]
fn step_number(value: &mut [f32], moments: &mut [f32], gradient: &[f32], count: u32, rate: f32, rates: Rates) {
    let i = ABSOLUTE_POS;
    if i < count as usize {
        let j = i + count as usize;
        let g = gradient[i];
        let m = rates.beta_1 * moments[i] + rates.new_1 * g;
        let v = rates.beta_2 * moments[j] + rates.new_2 * g * g;
        moments[i] = m;
        moments[j] = v;
        value[i] -= rate * m / (f32::sqrt(v) * rates.correction + rates.epsilon);
    }
}

#[cube(launch)]
fn adam_kernel(
    first_value: &mut [f32],
    first_moments: &mut [f32],
    first_gradient: &[f32],
    second_value: &mut [f32],
    second_moments: &mut [f32],
    second_gradient: &[f32],
    gate: &[f32],
    rates: Rates,
) {
    if gate[0] == 1.0f32 {
        step_number(first_value, first_moments, first_gradient, rates.first_count, rates.first_rate, rates);
        step_number(second_value, second_moments, second_gradient, rates.second_count, rates.second_rate, rates);
    }
}

/// The tensor itself if nothing else reads it or it is empty, else a copy.
fn owned(tensor: CubeTensor) -> CubeTensor {
    let tensor = floats(tensor);
    if tensor.can_mut() || tensor.shape().num_elements() == 0 { tensor } else { tensor.copy() }
}

fn prepared(AdamTensors { value, moments, gradient }: AdamTensors<CubeBackend>) -> AdamTensors<CubeBackend> {
    AdamTensors { value: owned(value), moments: owned(moments), gradient: floats(gradient) }
}

impl AdamOps for CubeBackend {
    fn adam_step(
        AdamPair { first, second }: AdamPair<Self>,
        gate: FloatTensor<Self>,
        (first_rate, second_rate): (f64, Option<f64>),
        step: AdamStep,
    ) -> AdamPair<Self> {
        let gate = floats(gate);
        let first = prepared(first);
        let second = match second_rate {
            Some(_) => prepared(second),
            None => {
                let [value, moments, gradient] = [(); 3].map(|()| empty_f32(&gate, [0]));
                AdamTensors { value, moments, gradient }
            }
        };
        let counts = [&first, &second].map(|parameter| parameter.value.shape().num_elements());
        let [rate, correction] = step.corrected(first_rate);
        let [other_rate, _] = step.corrected(second_rate.unwrap_or(0.0));
        let rates = RatesLaunch::new(
            rate as f32,
            other_rate as f32,
            correction as f32,
            step.beta_1 as f32,
            step.beta_2 as f32,
            (1.0 - step.beta_1) as f32,
            (1.0 - step.beta_2) as f32,
            step.epsilon as f32,
            counts[0] as u32,
            counts[1] as u32,
        );
        adam_kernel::launch(
            &gate.client.clone(),
            units(counts[0].max(counts[1])),
            cube_dim(),
            buffer(&first.value),
            buffer(&first.moments),
            buffer(&first.gradient),
            buffer(&second.value),
            buffer(&second.moments),
            buffer(&second.gradient),
            buffer(&gate),
            rates,
        );
        AdamPair { first, second }
    }
}
