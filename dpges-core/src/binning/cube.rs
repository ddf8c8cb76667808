//! GPU binning: count with integer atomics, prefix sum and fill.

use burn::backend::TensorMetadata;
use burn_cubecl::tensor::CubeTensor;
use cubecl::prelude::*;

use super::capacity::{self, ListKind};
use crate::camera::Camera;
use crate::footprint::splat_cube::{SPLAT, Splat};
use crate::gpu::launch::{UNITS, buffer, cube_dim, cubes, empty_f32, empty_u32, units, zeros_u32};
use crate::gpu::record::Record;
use crate::gpu::rect::Rect;
use crate::gpu::tile::TILE;
use crate::tiles::TileGrid;

/// Lists of primitives, one per tile. A list that ends beyond the capacity is incomplete ([`TileList`]).
pub struct CubeLists {
    /// [tiles + 1]
    pub offsets: CubeTensor,
    /// [capacity]
    pub ids: CubeTensor,
    pub capacity: u32,
}

/// Data of Gaussians that excludes tiles within their rectangles.
pub struct Ellipses<'a> {
    /// [M, [`SPLAT`]]
    pub splats: &'a CubeTensor,
    /// [tiles] depth at and behind which nothing is visible in a tile
    pub ends: &'a CubeTensor,
}

/// Writes each primitive to the list of every tile that it touches, at the `cursor` of the tile, and advances
/// the cursor. With cursors at 0 and a capacity of 0 the cursors end as counts.
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
    let rect = Rect::load(rects, i);
    if rect.is_filled() {
        for row in rect.y0 / TILE..rect.y1.div_ceil(TILE) {
            for column in rect.x0 / TILE..rect.x1.div_ceil(TILE) {
                let tile = (row * columns + column) as usize;
                let mut touched = true;
                if comptime!(elliptic) {
                    let splat = Splat::load(splats, i * SPLAT);
                    touched = splat.touches(column, row) && splat.depth < ends[tile];
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
    let mut sums = Shared::<[u32]>::new_slice(comptime!(UNITS as usize));
    let unit = UNIT_POS as usize;
    let mut carry = 0u32;
    let rounds = count.div_ceil(UNITS);
    for round in 0..rounds {
        let at = round * UNITS + UNIT_POS;
        let mut own = 0u32;
        if at < count {
            own = counts[at as usize];
        }
        sums[unit] = own;
        let mut step = 1usize;
        while step < UNITS as usize {
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
        carry += sums[UNITS as usize - 1];
        sync_cube();
    }
    if UNIT_POS == 0u32 {
        offsets[count as usize] = carry;
        total[0] = carry;
    }
}

/// Puts every list in ascending order: the place of an entry is the number of smaller entries.
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
            at += UNITS;
        }
    }
}

/// The list of a tile.
#[derive(CubeType, Clone, Copy)]
#[expand(derive(Clone, Copy))]
pub struct TileList {
    /// Place of the first entry.
    pub start: u32,
    pub length: u32,
    /// Whether the list fitted its buffer. If not, it stands for all primitives.
    listed: bool,
}

#[cube]
impl TileList {
    /// The list of the tile of this cube, from `count` primitives. It is uniform over the cube.
    pub fn own(offsets: &[u32], capacity: u32, count: u32) -> TileList {
        let mut range = Shared::<[u32]>::new_slice(2usize);
        if UNIT_POS == 0u32 {
            range[0] = offsets[CUBE_POS];
            range[1] = offsets[CUBE_POS + 1];
        }
        let low = workgroup_uniform_load(&range[0]);
        let high = workgroup_uniform_load(&range[1]);
        let listed = high <= capacity;
        TileList { start: select(listed, low, 0u32), length: select(listed, high - low, count), listed }
    }

    /// Primitive at place `at` of the list.
    pub fn entry(&self, ids: &[u32], at: u32) -> u32 {
        let mut id = at;
        if self.listed {
            id = ids[(self.start + at) as usize];
        }
        id
    }

    /// Batches of [`UNITS`] entries.
    pub fn batches(&self) -> u32 {
        self.length.div_ceil(UNITS)
    }

    /// Copies a batch into workgroup memory and returns its number of entries. The record of an entry is the
    /// row of its primitive in `first`, followed by that in `second`; `widths` are those of the two tables.
    /// All units of the cube must call this together.
    pub fn stage(
        &self,
        ids: &[u32],
        batch: u32,
        first: &[f32],
        second: &[f32],
        staged: &mut [f32],
        #[comptime] widths: (usize, usize),
    ) -> u32 {
        let (first_width, second_width) = comptime!(widths);
        let stride = comptime!(first_width + second_width);
        let at = batch * UNITS + UNIT_POS;
        sync_cube();
        if at < self.length {
            let id = self.entry(ids, at) as usize;
            let own = UNIT_POS as usize * stride;
            #[unroll]
            for number in 0..first_width {
                staged[own + number] = first[id * first_width + number];
            }
            #[unroll]
            for number in 0..second_width {
                staged[own + first_width + number] = second[id * second_width + number];
            }
        }
        sync_cube();
        min(UNITS, self.length - batch * UNITS)
    }
}

/// Lists of all tiles of the image of `camera`, for `rects` [N, 4] and, of Gaussians, their `ellipses`.
pub fn bin(rects: &CubeTensor, ellipses: Option<Ellipses>, camera: &Camera, kind: ListKind) -> CubeLists {
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
