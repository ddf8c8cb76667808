//! GPU kernel: one unit per pixel, integer atomics.

use burn::backend::TensorMetadata;
use burn::backend::ops::IntTensorOps;
use burn::backend::tensor::IntTensor;
use burn::tensor::IntDType;
use burn_cubecl::CubeBackend;
use cubecl::prelude::*;

use super::CoverageOps;
use crate::gpu::launch::{buffer, cube_dim, integers, units};

#[cube(launch)]
fn coverage_kernel(ids: &[i32], pixels: &[Atomic<i32>], count: u32) {
    let pixel = ABSOLUTE_POS;
    if pixel >= count as usize {
        terminate!();
    }
    let id = ids[pixel];
    if id >= 0i32 {
        // integers: counts do not depend on the order of the units
        pixels[id as usize].fetch_add(1i32);
    }
}

impl CoverageOps for CubeBackend {
    fn coverage(ids: IntTensor<Self>, count: usize) -> IntTensor<Self> {
        let ids = integers(ids);
        let [_, height, width] = ids.shape().dims();
        let pixels = Self::int_zeros([count].into(), &ids.device, IntDType::I32);
        coverage_kernel::launch(
            &ids.client.clone(),
            units(height * width),
            cube_dim(),
            buffer(&ids),
            buffer(&pixels),
            (height * width) as u32,
        );
        pixels
    }
}
