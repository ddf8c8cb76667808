//! GPU kernel: one unit per number. It tests bits, because WGSL implementations may ignore NaN.

use burn::backend::TensorMetadata;
use burn::backend::tensor::{FloatTensor, IntTensor};
use burn::tensor::DType;
use burn_cubecl::CubeBackend;
use cubecl::prelude::*;

use super::FiniteOps;
use crate::gpu::launch::{buffer, cube_dim, empty, floats, units, zeros_u32};

/// Raises `furthest` to the distance of a bad number from the end. It stays 0 if there is none.
#[cube(launch)]
fn finite_kernel(values: &[f32], furthest: &[Atomic<u32>], count: u32) {
    let i = ABSOLUTE_POS;
    if i >= count as usize {
        terminate!();
    }
    if (u32::reinterpret(values[i]) & 0x7f80_0000u32) == 0x7f80_0000u32 {
        furthest[0].fetch_max(count - i as u32);
    }
}

#[cube(launch)]
fn position_kernel(furthest: &[u32], position: &mut [i32], count: u32) {
    if ABSOLUTE_POS == 0usize {
        let distance = furthest[0];
        position[0] = select(distance > 0u32, i32::cast_from(count - distance), -1i32);
    }
}

impl FiniteOps for CubeBackend {
    fn first_non_finite(tensor: FloatTensor<Self>) -> IntTensor<Self> {
        let tensor = floats(tensor);
        let (client, count) = (tensor.client.clone(), tensor.shape().num_elements());
        let furthest = zeros_u32(&tensor, [1]);
        finite_kernel::launch(&client, units(count), cube_dim(), buffer(&tensor), buffer(&furthest), count as u32);
        let position = empty(&tensor, [1], DType::I32);
        position_kernel::launch(&client, units(1), cube_dim(), buffer(&furthest), buffer(&position), count as u32);
        position
    }
}
