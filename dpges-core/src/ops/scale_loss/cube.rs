//! GPU kernels: cubes leave what they find of their log-scales, which every cube of the next kernel puts together again in
//! the same order.

use burn::backend::TensorMetadata;
use burn::backend::tensor::FloatTensor;
use burn_cubecl::CubeBackend;
use burn_cubecl::tensor::CubeTensor;
use cubecl::prelude::*;

use super::autodiff::ScaleLossState;
use super::{LINEAR_FROM, ScaleLossOps, ScaleLossOutput};
use crate::backend::tape::BackwardState;
use crate::gpu::gather::zeros;
use crate::gpu::launch::{UNITS, buffer, cube_dim, cubes, empty_f32, floats, units};
use crate::gpu::reduce::{max_units, parts, sum_parts, sum_units};

const LINEAR_FROM_F32: f32 = LINEAR_FROM as f32;
/// Results of a cube from its log-scales: the largest, and the sum of their exponentials relative to it.
const FOUND: usize = 2;

#[cube(launch)]
fn moments_kernel(log_scales: &[f32], moments: &mut [f32], numbers: u32, parts: u32) {
    if CUBE_POS >= parts as usize {
        terminate!();
    }
    let mut memory = Shared::<[f32]>::new_slice(comptime!(UNITS as usize));
    let first = CUBE_POS as u32 * UNITS + UNIT_POS;
    // units without any see the last one, too
    let mut own_largest = log_scales[min(first, numbers - 1u32) as usize];
    let mut at = first;
    while at < numbers {
        own_largest = max(own_largest, log_scales[at as usize]);
        at += parts * UNITS;
    }
    max_units(own_largest, &mut memory);
    let largest = memory[0];
    let mut own = zeros(1usize);
    let mut again = first;
    while again < numbers {
        // relative to the largest of the cube, so that no exponential overflows in a world of any size
        own[0] += f32::exp(log_scales[again as usize] - largest);
        again += parts * UNITS;
    }
    sum_units(&own, &mut memory, 1usize);
    if UNIT_POS == 0u32 {
        moments[CUBE_POS * FOUND] = largest;
        moments[CUBE_POS * FOUND + 1] = memory[0];
    }
}

/// Logarithm of the mean of so many scales, from what the cubes found: one part for a unit. All units of the cube must call
/// this together.
#[cube]
fn log_mean_of(moments: &[f32], numbers: u32, parts: u32, memory: &mut [f32]) -> f32 {
    // units beyond the parts look at the last one, whose sum they count as 0
    let part = min(UNIT_POS, parts - 1u32) as usize * FOUND;
    let own_largest = moments[part];
    let own_sum = select(UNIT_POS < parts, moments[part + 1], 0.0f32);
    max_units(own_largest, memory);
    let largest = memory[0];
    let mut own = zeros(1usize);
    own[0] = own_sum * f32::exp(own_largest - largest);
    sum_units(&own, memory, 1usize);
    largest + f32::ln(memory[0] / f32::cast_from(numbers))
}

/// Sums of the costs of surfels. The first cube also leaves the logarithm of the mean scale.
#[cube(launch)]
fn costs_kernel(
    log_scales: &[f32],
    moments: &[f32],
    sums: &mut [f32],
    log_mean: &mut [f32],
    surfels: u32,
    parts: u32,
    moment_parts: u32,
) {
    if CUBE_POS >= parts as usize {
        terminate!();
    }
    let mut memory = Shared::<[f32]>::new_slice(comptime!(UNITS as usize));
    // every cube finds the mean for itself, in one order, which saves a launch
    let mean = log_mean_of(moments, 2u32 * surfels, moment_parts, &mut memory);
    let mut own = zeros(1usize);
    let mut surfel = CUBE_POS as u32 * UNITS + UNIT_POS;
    while surfel < surfels {
        let at = 2 * surfel as usize;
        let x = 0.5f32 * (f32::exp(log_scales[at] - mean) + f32::exp(log_scales[at + 1] - mean));
        let clamped = min(x, LINEAR_FROM_F32);
        // e⁸⁸ is about the largest f32: one huge surfel would spoil the loss of all
        own[0] += f32::exp(clamped) * (x - clamped + 1.0f32);
        surfel += parts * UNITS;
    }
    sum_units(&own, &mut memory, 1usize);
    if UNIT_POS == 0u32 {
        sums[CUBE_POS] = memory[0];
        if CUBE_POS == 0usize {
            log_mean[0] = mean;
        }
    }
}

#[cube(launch)]
fn value_kernel(sums: &[f32], weighted: &mut [f32], value: &mut [f32], surfels: u32, parts: u32, weight: f32) {
    if CUBE_POS > 0usize {
        terminate!();
    }
    let mut memory = Shared::<[f32]>::new_slice(comptime!(UNITS as usize));
    sum_parts(sums, parts, &mut memory, 1usize);
    if UNIT_POS == 0u32 {
        let mean = memory[0] / f32::cast_from(surfels);
        weighted[0] = weight * mean;
        value[0] = mean;
    }
}

#[cube(launch)]
fn backward_kernel(
    log_scales: &[f32],
    log_mean: &[f32],
    grad: &[f32],
    grad_log_scales: &mut [f32],
    surfels: u32,
    share: f32,
) {
    let surfel = ABSOLUTE_POS;
    if surfel >= surfels as usize {
        terminate!();
    }
    let (first, second) = (2 * surfel, 2 * surfel + 1);
    let (across, along) = (f32::exp(log_scales[first] - log_mean[0]), f32::exp(log_scales[second] - log_mean[0]));
    let slope = grad[0] * share * f32::exp(min(0.5f32 * (across + along), LINEAR_FROM_F32));
    grad_log_scales[first] = slope * across;
    grad_log_scales[second] = slope * along;
}

impl ScaleLossOps for CubeBackend {
    fn scale_loss(log_scales: FloatTensor<Self>, weight: f64) -> ScaleLossOutput<Self> {
        let log_scales = floats(log_scales);
        let (client, surfels) = (log_scales.client.clone(), log_scales.shape()[0]);
        let (moment_parts, parts) = (parts(2 * surfels), parts(surfels));
        let moments = empty_f32(&log_scales, [moment_parts, FOUND]);
        moments_kernel::launch(
            &client,
            cubes(moment_parts),
            cube_dim(),
            buffer(&log_scales),
            buffer(&moments),
            2 * surfels as u32,
            moment_parts as u32,
        );
        let sums = empty_f32(&log_scales, [parts]);
        let [weighted, value, log_mean] = [(); 3].map(|()| empty_f32(&log_scales, [1]));
        costs_kernel::launch(
            &client,
            cubes(parts),
            cube_dim(),
            buffer(&log_scales),
            buffer(&moments),
            buffer(&sums),
            buffer(&log_mean),
            surfels as u32,
            parts as u32,
            moment_parts as u32,
        );
        value_kernel::launch(
            &client,
            cubes(1),
            cube_dim(),
            buffer(&sums),
            buffer(&weighted),
            buffer(&value),
            surfels as u32,
            parts as u32,
            weight as f32,
        );
        ScaleLossOutput { weighted, value, log_mean }
    }
}

impl BackwardState<CubeBackend, 1> for ScaleLossState<CubeBackend> {
    fn backward(self, grad: CubeTensor) -> [Option<CubeTensor>; 1] {
        let [log_scales, log_mean, grad] = [self.log_scales, self.log_mean, grad].map(floats);
        let surfels = log_scales.shape()[0];
        let out = empty_f32(&log_scales, [surfels, 2]);
        backward_kernel::launch(
            &log_scales.client.clone(),
            units(surfels),
            cube_dim(),
            buffer(&log_scales),
            buffer(&log_mean),
            buffer(&grad),
            buffer(&out),
            surfels as u32,
            (self.weight * 0.5 / surfels as f64) as f32,
        );
        [Some(out)]
    }
}
