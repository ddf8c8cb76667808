//! GPU kernels: one unit per place in all tensors of a list. It tests bits, because WGSL implementations may ignore NaN.

use burn::backend::TensorMetadata;
use burn::backend::tensor::IntTensor;
use burn_cubecl::CubeBackend;
use cubecl::prelude::*;

use super::{FiniteOps, GateOutput};
use crate::backend::tensor_list::{LIST_LENGTH, PerTensor, TensorList};
use crate::gpu::launch::{buffer, cube_dim, cubes, empty_f32, floats, units};

/// Lowers the position of a tensor to a place with a bad number. Without one it is the largest number, which as a signed
/// one is −1.
#[cube]
fn look(values: &[f32], count: u32, positions: &[Atomic<u32>], tensor: u32) {
    let i = ABSOLUTE_POS;
    if i < count as usize {
        let bad = (u32::reinterpret(values[i]) & 0x7f80_0000u32) == 0x7f80_0000u32;
        if bad {
            // the least position is the same in any order of the units
            positions[tensor as usize].fetch_min(i as u32);
        }
    }
}

/// The tensors have these `counts` of numbers, and the positions from `from` on.
#[cube(launch)]
fn finite_kernel(
    first: &[f32],
    second: &[f32],
    third: &[f32],
    fourth: &[f32],
    fifth: &[f32],
    sixth: &[f32],
    positions: &[Atomic<u32>],
    counts: PerTensor,
    from: u32,
) {
    // six tensors, the positions and the scalars are the eight buffers that WebGPU binds
    look(first, counts.first, positions, from);
    look(second, counts.second, positions, from + 1u32);
    look(third, counts.third, positions, from + 2u32);
    look(fourth, counts.fourth, positions, from + 3u32);
    look(fifth, counts.fifth, positions, from + 4u32);
    look(sixth, counts.sixth, positions, from + 5u32);
}

#[cube(launch)]
fn gate_kernel(positions: &[i32], open: &mut [f32], bad: &mut [f32], count: u32) {
    if ABSOLUTE_POS == 0usize {
        let mut found = 0.0f32;
        for tensor in 0..count {
            found += select(positions[tensor as usize] >= 0i32, 1.0f32, 0.0f32);
        }
        // left on the device for the kernel of Adam: nothing waits for the host
        open[0] = select(found == 0.0f32, 1.0f32, 0.0f32);
        bad[0] = found;
    }
}

impl FiniteOps for CubeBackend {
    fn first_non_finite(
        list: TensorList<Self>,
        count: usize,
        positions: IntTensor<Self>,
        first: usize,
    ) -> IntTensor<Self> {
        let tensors = list.into_tensors().map(floats);
        let positions = if positions.can_mut() { positions } else { positions.copy() };
        let numbers: [usize; LIST_LENGTH] =
            std::array::from_fn(|at| if at < count { tensors[at].shape().num_elements() } else { 0 });
        let client = positions.client.clone();
        finite_kernel::launch(
            &client,
            units(numbers.into_iter().max().unwrap_or(0)),
            cube_dim(),
            buffer(&tensors[0]),
            buffer(&tensors[1]),
            buffer(&tensors[2]),
            buffer(&tensors[3]),
            buffer(&tensors[4]),
            buffer(&tensors[5]),
            buffer(&positions),
            PerTensor::launch(numbers),
            first as u32,
        );
        positions
    }

    fn gate(positions: IntTensor<Self>) -> GateOutput<Self> {
        let [open, bad] = [(); 2].map(|()| empty_f32(&positions, [1]));
        gate_kernel::launch(
            &positions.client.clone(),
            cubes(1),
            cube_dim(),
            buffer(&positions),
            buffer(&open),
            buffer(&bad),
            positions.shape().num_elements() as u32,
        );
        GateOutput { open, bad }
    }
}
