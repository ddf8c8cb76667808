//! Sorts primitives by depth and the list of every tile by index, with bitonic sorting networks. Every
//! comparison puts the larger value behind. Places beyond the end count as the largest value, which such a
//! network never moves.

use burn::backend::TensorMetadata;
use burn_cubecl::tensor::CubeTensor;
use cubecl::prelude::*;

use crate::binning::cube::{CubeLists, TileList};
use crate::camera::Camera;
use crate::gpu::launch::{UNITS, buffer, cube_dim, cubes, empty_u32, units};
use crate::gpu::vector::row3;
use crate::gpu::view::{CameraUniforms, to_camera, view_depth};

/// Values that one cube sorts. Each unit compares two.
const BLOCK: usize = 2 * UNITS as usize;

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

/// The two places of a comparison: `step` apart, or mirrored in the middle of 2 · `step` places.
#[cube]
fn places(pair: u32, step: u32, mirrored: bool) -> (u32, u32) {
    let (first, within) = (pair / step * step * 2u32, pair % step);
    let low = first + within;
    (low, select(mirrored, first + 2u32 * step - 1u32 - within, low + step))
}

/// Compares (key, index) at two places.
#[cube]
fn compare(keys: &mut [u32], order: &mut [u32], low: u32, high: u32, count: u32) {
    if high < count {
        let (a, b) = (low as usize, high as usize);
        let (key_a, key_b) = (keys[a], keys[b]);
        let (index_a, index_b) = (order[a], order[b]);
        if key_b < key_a || (key_b == key_a && index_b < index_a) {
            keys[a] = key_b;
            keys[b] = key_a;
            order[a] = index_b;
            order[b] = index_a;
        }
    }
}

/// Sorts every block if `first` is 1. If it is half a block, does the steps of a merge within blocks.
#[cube(launch)]
fn block_kernel(keys: &mut [u32], order: &mut [u32], count: u32, first: u32) {
    let pair = ABSOLUTE_POS as u32;
    let mut half = first;
    while half <= UNITS {
        let mut step = half;
        while step > 0u32 {
            let (low, high) = places(pair, step, step == half && first == 1u32);
            compare(keys, order, low, high, count);
            sync_storage();
            step /= 2u32;
        }
        half *= 2u32;
    }
}

/// One step of a merge across blocks.
#[cube(launch)]
fn step_kernel(keys: &mut [u32], order: &mut [u32], count: u32, step: u32, mirrored: u32) {
    let (low, high) = places(ABSOLUTE_POS as u32, step, mirrored == 1u32);
    compare(keys, order, low, high, count);
}

/// [M] indices of the primitives at `positions` [M, 3] by (depth, index). Primitives at or behind the camera
/// come last.
pub fn depth_order(positions: &CubeTensor, camera: &Camera) -> CubeTensor {
    let (client, count) = (positions.client.clone(), positions.shape()[0]);
    let (keys, order) = (empty_u32(positions, [count]), empty_u32(positions, [count]));
    keys_kernel::launch(
        &client,
        units(count),
        cube_dim(),
        buffer(positions),
        buffer(&keys),
        buffer(&order),
        CameraUniforms::launch(camera),
        count as u32,
    );
    let in_blocks = |first: u32| {
        let blocks = cubes(count.div_ceil(BLOCK));
        block_kernel::launch(&client, blocks, cube_dim(), buffer(&keys), buffer(&order), count as u32, first);
    };
    in_blocks(1);
    let mut half = BLOCK;
    while half < count {
        let mut step = half;
        while step >= BLOCK {
            step_kernel::launch(
                &client,
                units(count.next_power_of_two() / 2),
                cube_dim(),
                buffer(&keys),
                buffer(&order),
                count as u32,
                step as u32,
                u32::from(step == half),
            );
            step /= 2;
        }
        in_blocks(UNITS);
        half *= 2;
    }
    order
}

/// Sorts every list that fits its buffer: one cube per tile.
#[cube(launch)]
fn lists_kernel(offsets: &[u32], ids: &mut [u32], tiles: u32, capacity: u32) {
    if CUBE_POS >= tiles as usize {
        terminate!();
    }
    // a list that does not fit has no entries here
    let list = TileList::own(offsets, capacity, 0u32);
    let (start, length) = (list.start, list.length);
    let mut half = 1u32;
    while half < length {
        let mut step = half;
        while step > 0u32 {
            let mirrored = step == half;
            let pairs = length.div_ceil(2u32 * step) * step;
            let mut pair = UNIT_POS;
            while pair < pairs {
                let (low, high) = places(pair, step, mirrored);
                if high < length {
                    let (a, b) = ((start + low) as usize, (start + high) as usize);
                    let (id_a, id_b) = (ids[a], ids[b]);
                    if id_b < id_a {
                        ids[a] = id_b;
                        ids[b] = id_a;
                    }
                }
                pair += UNITS;
            }
            sync_storage();
            step /= 2u32;
        }
        half *= 2u32;
    }
}

/// The same lists, each in ascending order.
pub fn sorted(lists: CubeLists, tiles: usize) -> CubeLists {
    lists_kernel::launch(
        &lists.ids.client.clone(),
        cubes(tiles),
        cube_dim(),
        buffer(&lists.offsets),
        buffer(&lists.ids),
        tiles as u32,
        lists.capacity,
    );
    lists
}
