//! GPU kernel: one unit per number, in place where nothing else shares the buffers.

use burn::backend::TensorMetadata;
use burn::backend::tensor::FloatTensor;
use burn_cubecl::CubeBackend;
use burn_cubecl::tensor::CubeTensor;
use cubecl::prelude::*;

use super::{AdamOps, AdamOutput, AdamStep};
use crate::gpu::launch::{buffer, cube_dim, floats, units};

#[derive(CubeType, CubeLaunch, Clone, Copy)]
#[expand(derive(Clone, Copy))]
struct Rates {
    /// Learning rate over the bias correction of the first moment.
    rate: f32,
    /// Reciprocal root of the bias correction of the second moment.
    correction: f32,
    beta_1: f32,
    beta_2: f32,
    /// 1 − β1 and 1 − β2, rounded once.
    new_1: f32,
    new_2: f32,
    epsilon: f32,
    count: u32,
}

#[cube(launch)]
fn adam_kernel(
    parameter: &mut [f32],
    moment_1: &mut [f32],
    moment_2: &mut [f32],
    grad: &[f32],
    gate: &[f32],
    rates: Rates,
) {
    let i = ABSOLUTE_POS;
    if i >= rates.count as usize {
        terminate!();
    }
    // read on the device, so that no step waits for the host to learn whether it may be taken
    if gate[0] == 1.0f32 {
        let g = grad[i];
        let m = rates.beta_1 * moment_1[i] + rates.new_1 * g;
        let v = rates.beta_2 * moment_2[i] + rates.new_2 * g * g;
        moment_1[i] = m;
        moment_2[i] = v;
        parameter[i] -= rates.rate * m / (f32::sqrt(v) * rates.correction + rates.epsilon);
    }
}

/// The tensor itself if nothing else reads it, else a copy.
fn owned(tensor: CubeTensor) -> CubeTensor {
    let tensor = floats(tensor);
    if tensor.can_mut() { tensor } else { tensor.copy() }
}

impl AdamOps for CubeBackend {
    fn adam_step(
        parameter: FloatTensor<Self>,
        moment_1: FloatTensor<Self>,
        moment_2: FloatTensor<Self>,
        grad: FloatTensor<Self>,
        gate: FloatTensor<Self>,
        step: AdamStep,
    ) -> AdamOutput<Self> {
        let count = parameter.shape().num_elements();
        if count == 0 {
            return AdamOutput { parameter, moment_1, moment_2 };
        }
        // a write into a shared buffer would change the tensors of others
        let [parameter, moment_1, moment_2] = [parameter, moment_1, moment_2].map(owned);
        let (grad, gate) = (floats(grad), floats(gate));
        let [rate, correction] = step.corrected().map(|number| number as f32);
        let rates = RatesLaunch::new(
            rate,
            correction,
            step.beta_1 as f32,
            step.beta_2 as f32,
            // subtracted in f64: from 0.999 as an f32, 1 − β would be off by 3e-5 of itself
            (1.0 - step.beta_1) as f32,
            (1.0 - step.beta_2) as f32,
            step.epsilon as f32,
            count as u32,
        );
        adam_kernel::launch(
            &grad.client.clone(),
            units(count),
            cube_dim(),
            buffer(&parameter),
            buffer(&moment_1),
            buffer(&moment_2),
            buffer(&grad),
            buffer(&gate),
            rates,
        );
        AdamOutput { parameter, moment_1, moment_2 }
    }
}
