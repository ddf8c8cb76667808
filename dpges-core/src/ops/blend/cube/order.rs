//! Primitives in the order of their depths, and what sorts them in a tile by their depths along rays (StopThePop).

use burn::backend::TensorMetadata;
use burn_cubecl::tensor::CubeTensor;
use cubecl::prelude::*;

use crate::camera::Camera;
use crate::footprint::gaussian::cube::along_ray::{AlongRay, ROW, unit_ray};
use crate::footprint::gaussian::cube::{SPLAT, Splat};
use crate::gpu::launch::{buffer, cube_dim, empty_u32, units};
use crate::gpu::record::Record;
use crate::gpu::sort::sorted_pairs;
use crate::gpu::tile::TILE;
use crate::gpu::vector::row3;
use crate::gpu::view::{CameraUniforms, to_camera, view_depth};
use crate::tiles::binning::cube::Pairs;

/// Key that no number has.
pub const NO_KEY: u32 = u32::MAX;
const SIGN: u32 = 1 << 31;

/// Bits of the depth of every primitive. As integers they ascend with positive depth, and negative depths
/// come last.
#[cube(launch)]
fn keys_kernel(positions: &[f32], keys: &mut [u32], order: &mut [u32], view: CameraUniforms, count: u32) {
    let i = ABSOLUTE_POS;
    if i >= count as usize {
        terminate!();
    }
    let centre = to_camera(view, row3(positions, i));
    // bits of positive floats ascend like the floats; what is behind the camera is not drawn
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
    // stable: equal depths keep the order of their indices
    sorted_pairs(keys, order, u32::BITS).1
}

/// Bits that ascend with `value`, negative or not.
#[cube]
pub fn sort_key(value: f32) -> u32 {
    let bits = u32::reinterpret(value);
    // negative numbers have all bits flipped, since those larger in size are smaller
    bits ^ select(bits >= SIGN, NO_KEY, SIGN)
}

#[cube(launch)]
fn tile_keys_kernel(
    table: &[f32],
    primitives: &[u32],
    tiles: &[u32],
    keys: &mut [u32],
    view: CameraUniforms,
    count: u32,
) {
    let pair = ABSOLUTE_POS;
    if pair >= count as usize {
        terminate!();
    }
    let tile = tiles[pair];
    // beyond the tiles there is no pair
    let mut key = 0u32;
    if tile < view.columns * view.rows {
        let row = primitives[pair] as usize * ROW;
        let splat = Splat::load(table, row);
        let at = splat.nearest(tile % view.columns * TILE, tile / view.columns * TILE, TILE, TILE);
        let ray = unit_ray(view, splat.mean_x + at.dx, splat.mean_y + at.dy);
        key = sort_key(AlongRay::load(table, row + SPLAT).depth(ray));
    }
    keys[pair] = key;
}

/// `[pairs]` what sorts the pairs of a tile: t* of the primitive where its α is largest in the tile.
pub fn tile_keys(table: &CubeTensor, pairs: &Pairs, camera: &Camera) -> CubeTensor {
    let count = pairs.primitives.shape()[0];
    let keys = empty_u32(table, [count]);
    tile_keys_kernel::launch(
        &table.client.clone(),
        units(count),
        cube_dim(),
        buffer(table),
        buffer(&pairs.primitives),
        buffer(&pairs.tiles),
        buffer(&keys),
        CameraUniforms::launch(camera),
        count as u32,
    );
    keys
}
