//! GPU kernel: one unit per number.

use burn::backend::TensorMetadata;
use burn::backend::tensor::FloatTensor;
use burn_cubecl::CubeBackend;
use cubecl::prelude::*;

use super::JoinOps;
use crate::backend::tensor_list::{LIST_LENGTH, PerTensor, TensorList};
use crate::gpu::launch::{buffer, cube_dim, empty_f32, floats, units};

/// The number at place `at` of all if it is one of the `part` with the places from `start` to `end`, else 0.
#[cube]
fn number(part: &[f32], at: u32, start: u32, end: u32) -> f32 {
    let mut number = 0.0f32;
    if at >= start && at < end {
        number = part[(at - start) as usize];
    }
    number
}

/// `ends` are the numbers before the end of each tensor.
#[cube(launch)]
fn join_kernel(
    first: &[f32],
    second: &[f32],
    third: &[f32],
    fourth: &[f32],
    fifth: &[f32],
    sixth: &[f32],
    out: &mut [f32],
    ends: PerTensor,
) {
    let i = ABSOLUTE_POS as u32;
    if i >= ends.sixth {
        terminate!();
    }
    out[i as usize] = number(first, i, 0u32, ends.first)
        + number(second, i, ends.first, ends.second)
        + number(third, i, ends.second, ends.third)
        + number(fourth, i, ends.third, ends.fourth)
        + number(fifth, i, ends.fourth, ends.fifth)
        + number(sixth, i, ends.fifth, ends.sixth);
}

impl JoinOps for CubeBackend {
    fn join(list: TensorList<Self>, count: usize) -> FloatTensor<Self> {
        let tensors = list.into_tensors().map(floats);
        let mut end = 0;
        let ends: [usize; LIST_LENGTH] = std::array::from_fn(|at| {
            end += if at < count { tensors[at].shape().num_elements() } else { 0 };
            end
        });
        let out = empty_f32(&tensors[0], [end]);
        join_kernel::launch(
            &out.client.clone(),
            units(end),
            cube_dim(),
            buffer(&tensors[0]),
            buffer(&tensors[1]),
            buffer(&tensors[2]),
            buffer(&tensors[3]),
            buffer(&tensors[4]),
            buffer(&tensors[5]),
            buffer(&out),
            PerTensor::launch(ends),
        );
        out
    }
}
