//! GPU kernels: counting with integer atomics, a prefix sum, a fill. The lists of tiles are in no
//! particular order unless order is asked for.

use burn_cubecl::tensor::CubeTensor;
use cubecl::prelude::*;

use super::capacity::{self, ListKind};
use crate::camera::Camera;
use crate::gpu::launch::{UNITS, buffer, cube_dim, cubes, empty_f32, empty_u32, units, zeros_u32};
use crate::gpu::view::View;
use crate::tiles::{TILE, TileGrid};

/// Lists of primitives, one per tile. Those that end beyond the capacity are incomplete: see [`tile_list`].
pub struct CubeLists {
    /// [tiles + 1]
    pub offsets: CubeTensor,
    /// [capacity]
    pub ids: CubeTensor,
    pub capacity: u32,
}

/// What Gaussians know beside their rectangle.
pub struct Ellipses<'a> {
    /// [M, [`SPLAT`]]
    pub splats: &'a CubeTensor,
    /// [tiles] depth at and behind which nothing is visible in a tile
    pub ends: &'a CubeTensor,
}

/// Numbers of a projected Gaussian: mean, conic, strength, depth, squared radius.
pub const SPLAT: usize = 8;

/// Whether a Gaussian can add to a pixel of a tile: its ellipse reaches a pixel centre, and it is not
/// behind everything visible there.
#[cube]
fn reaches(splats: &[f32], ends: &[f32], i: usize, column: u32, row: u32, tile: usize) -> bool {
    let o = i * SPLAT;
    let (a, b, c) = (splats[o + 2], splats[o + 3], splats[o + 4]);
    let x0 = f32::cast_from(column * 16u32) + 0.5f32 - splats[o];
    let y0 = f32::cast_from(row * 16u32) + 0.5f32 - splats[o + 1];
    let (x1, y1) = (x0 + 15.0f32, y0 + 15.0f32);
    let dx = clamp(0.0f32, x0, x1);
    let dy = clamp(0.0f32, y0, y1);
    // the convex form is smallest at the mean or on one of the two edges that face it
    let beside = clamp(-b * dx / c, y0, y1);
    let below = clamp(-b * dy / a, x0, x1);
    let on_vertical = a * dx * dx + 2.0f32 * b * dx * beside + c * beside * beside;
    let on_horizontal = a * below * below + 2.0f32 * b * below * dy + c * dy * dy;
    let outside = min(on_vertical, on_horizontal) > splats[o + 7] * 1.001f32 + 0.01f32;
    !outside && splats[o + 6] < ends[tile]
}

/// Visits every tile that a primitive touches, raises the tile's `cursor` and enters the primitive into
/// `ids` where it stood. From cursors at 0 and without room for entries, that counts.
#[cube(launch)]
fn visit_kernel(
    rects: &[u32],
    splats: &[f32],
    ends: &[f32],
    cursor: &[Atomic<u32>],
    ids: &mut [u32],
    columns: u32,
    count: u32,
    capacity: u32,
    #[comptime] elliptic: bool,
) {
    let i = ABSOLUTE_POS;
    if i >= count as usize {
        terminate!();
    }
    let (x0, x1, y0, y1) = (rects[4 * i], rects[4 * i + 1], rects[4 * i + 2], rects[4 * i + 3]);
    if x0 < x1 && y0 < y1 {
        for row in y0 / 16u32..y1.div_ceil(16u32) {
            for column in x0 / 16u32..x1.div_ceil(16u32) {
                let tile = (row * columns + column) as usize;
                let mut touched = true;
                if comptime!(elliptic) {
                    touched = reaches(splats, ends, i, column, row, tile);
                }
                if touched {
                    let slot = cursor[tile].fetch_add(1u32);
                    if slot < capacity {
                        ids[slot as usize] = i as u32;
                    }
                }
            }
        }
    }
}

/// Exclusive prefix sum of `counts` by one cube; `total` is the sum.
#[cube(launch)]
fn scan_kernel(counts: &[u32], offsets: &mut [u32], cursor: &mut [u32], total: &mut [u32], count: u32) {
    let mut sums = Shared::<[u32]>::new_slice(256usize);
    let unit = UNIT_POS as usize;
    let mut carry = 0u32;
    let rounds = count.div_ceil(256u32);
    for round in 0..rounds {
        let at = round * 256u32 + UNIT_POS;
        let mut own = 0u32;
        if at < count {
            own = counts[at as usize];
        }
        sums[unit] = own;
        let mut step = 1usize;
        while step < 256usize {
            sync_cube();
            let mut sum = sums[unit];
            if unit >= step {
                sum += sums[unit - step];
            }
            sync_cube();
            sums[unit] = sum;
            step *= 2;
        }
        sync_cube();
        if at < count {
            let before = carry + sums[unit] - own;
            offsets[at as usize] = before;
            cursor[at as usize] = before;
        }
        carry += sums[255];
        sync_cube();
    }
    if UNIT_POS == 0u32 {
        offsets[count as usize] = carry;
        total[0] = carry;
    }
}

/// Puts every list in ascending order: an entry's place is the number of smaller ones.
#[cube(launch)]
fn rank_kernel(offsets: &[u32], ids: &[u32], ranked: &mut [u32], tiles: u32, capacity: u32) {
    if CUBE_POS >= tiles as usize {
        terminate!();
    }
    let (low, high) = (offsets[CUBE_POS], offsets[CUBE_POS + 1]);
    if high <= capacity {
        let mut at = low + UNIT_POS;
        while at < high {
            let id = ids[at as usize];
            let mut place = low;
            for other in low..high {
                if ids[other as usize] < id {
                    place += 1u32;
                }
            }
            ranked[place as usize] = id;
            at += 256u32;
        }
    }
}

/// Where the list of this cube's tile starts, its length, and whether it is one: a list that did not
/// fit is replaced by all `count` primitives. The same for all units of the cube.
#[cube]
pub fn tile_list(offsets: &[u32], capacity: u32, count: u32) -> (u32, u32, u32) {
    let mut range = Shared::<[u32]>::new_slice(2usize);
    if UNIT_POS == 0u32 {
        range[0] = offsets[CUBE_POS];
        range[1] = offsets[CUBE_POS + 1];
    }
    let low = workgroup_uniform_load(&range[0]);
    let high = workgroup_uniform_load(&range[1]);
    let listed = high <= capacity;
    (select(listed, low, 0u32), select(listed, high - low, count), u32::cast_from(listed))
}

/// Entry `at` of a list from [`tile_list`].
#[cube]
pub fn entry(ids: &[u32], start: u32, at: u32, listed: u32) -> u32 {
    let mut id = at;
    if listed == 1u32 {
        id = ids[(start + at) as usize];
    }
    id
}

/// Column and row of this unit's pixel in this cube's tile.
#[cube]
pub fn own_pixel(view: View) -> (u32, u32) {
    let tile = CUBE_POS as u32;
    (tile % view.columns * 16u32 + UNIT_POS % 16u32, tile / view.columns * 16u32 + UNIT_POS / 16u32)
}

/// Lists of all tiles for `rects` [count, 4] (x0, x1, y0, y1; half open, px).
pub fn bin(rects: &CubeTensor, ellipses: Option<Ellipses>, camera: &Camera, kind: ListKind) -> CubeLists {
    const { assert!(TILE * TILE == UNITS as usize, "one unit per pixel of a tile") };
    use burn::backend::TensorMetadata;
    let (grid, count) = (TileGrid::new(camera.width, camera.height), rects.shape()[0]);
    let (client, tiles) = (rects.client.clone(), grid.len());
    let unused = empty_f32(rects, [1]);
    let elliptic = ellipses.is_some();
    let (splats, ends) = ellipses.map_or((&unused, &unused), |e| (e.splats, e.ends));
    let counts = zeros_u32(rects, [tiles]);
    let visit = |cursor: &CubeTensor, ids: &CubeTensor, capacity: u32| {
        visit_kernel::launch(
            &client,
            units(count),
            cube_dim(),
            buffer(rects),
            buffer(splats),
            buffer(ends),
            buffer(cursor),
            buffer(ids),
            grid.columns as u32,
            count as u32,
            capacity,
            elliptic,
        );
    };
    visit(&counts, &empty_u32(rects, [1]), 0);
    let (offsets, cursor, total) = (empty_u32(rects, [tiles + 1]), empty_u32(rects, [tiles]), empty_u32(rects, [1]));
    scan_kernel::launch(
        &client,
        cubes(1),
        cube_dim(),
        buffer(&counts),
        buffer(&offsets),
        buffer(&cursor),
        buffer(&total),
        tiles as u32,
    );
    let capacity = capacity::entries(rects, kind, count, tiles);
    let ids = empty_u32(rects, [capacity]);
    let capacity = u32::try_from(capacity).unwrap_or(u32::MAX);
    visit(&cursor, &ids, capacity);
    capacity::observe(&total, kind, capacity as usize);
    CubeLists { offsets, ids, capacity }
}

impl CubeLists {
    /// The same lists, each in ascending order.
    pub fn ranked(self, tiles: usize) -> Self {
        let ranked = empty_u32(&self.ids, [self.capacity as usize]);
        rank_kernel::launch(
            &self.ids.client.clone(),
            cubes(tiles),
            cube_dim(),
            buffer(&self.offsets),
            buffer(&self.ids),
            buffer(&ranked),
            tiles as u32,
            self.capacity,
        );
        Self { ids: ranked, ..self }
    }
}
