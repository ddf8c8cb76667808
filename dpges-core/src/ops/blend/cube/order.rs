//! Primitives in the order of their depths.

use burn::backend::TensorMetadata;
use burn_cubecl::tensor::CubeTensor;
use cubecl::prelude::*;

use crate::camera::Camera;
use crate::gpu::launch::{buffer, cube_dim, empty_u32, units};
use crate::gpu::sort::sorted_pairs;
use crate::gpu::vector::row3;
use crate::gpu::view::{CameraUniforms, to_camera, view_depth};

/// Bits of the depth of every primitive. As integers they ascend with positive depth, and negative depths
/// come last.
#[cube(launch)]
fn keys_kernel(positions: &[f32], keys: &mut [u32], order: &mut [u32], view: CameraUniforms, count: u32) {
    let i = ABSOLUTE_POS;
    if i >= count as usize {
        terminate!();
    }
    let centre = to_camera(view, row3(positions, i));
    keys[i] = u32::reinterpret(view_depth(view, centre));
    order[i] = i as u32;
}

/// [M] indices of the primitives at `positions` [M, 3] by (depth, index). Primitives at or behind the camera
/// come last.
pub fn depth_order(positions: &CubeTensor, camera: &Camera) -> CubeTensor {
    let count = positions.shape()[0];
    let (keys, order) = (empty_u32(positions, [count]), empty_u32(positions, [count]));
    keys_kernel::launch(
        &positions.client.clone(),
        units(count),
        cube_dim(),
        buffer(positions),
        buffer(&keys),
        buffer(&order),
        CameraUniforms::launch(camera),
        count as u32,
    );
    sorted_pairs(keys, order, u32::BITS).1
}
