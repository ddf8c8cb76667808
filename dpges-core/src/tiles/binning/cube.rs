//! GPU binning: pairs of a primitive and a tile in the order of the primitives, then a stable sort by tile. Every list
//! is therefore in ascending order, and no unit visits more than one tile.

use burn::backend::TensorMetadata;
use burn_cubecl::tensor::CubeTensor;
use cubecl::prelude::*;

use super::capacity::{self, ListKind};
use crate::camera::Camera;
use crate::footprint::gaussian::cube::{SPLAT, Splat};
use crate::gpu::launch::{UNITS, buffer, cube_dim, empty_f32, empty_u32, first_of, units};
use crate::gpu::record::Record;
use crate::gpu::rect::Rect;
use crate::gpu::scan;
use crate::gpu::sort::sorted_pairs;
use crate::gpu::tile::TILE;
use crate::gpu::work_split::owner::{lower_bound, own_owner};
use crate::tiles::TileGrid;

/// Lists of primitives, one per tile, each in ascending order.
pub struct CubeLists {
    /// [tiles + 1]
    pub offsets: CubeTensor,
    /// `[capacity]`; beyond the last list of any value
    pub ids: CubeTensor,
    pub capacity: u32,
}

/// Data of Gaussians for culling: it excludes tiles within their rectangles.
pub struct Ellipses<'a> {
    /// [M, [`SPLAT`]]
    pub splats: &'a CubeTensor,
    /// [tiles] depth at and behind which nothing is visible in a tile
    pub ends: &'a CubeTensor,
}

/// The pairs of each primitive and the tiles of its rectangle, by primitive and then by tile. Within
/// [`defer_readback`](crate::tiles::lists::defer_readback) there are more places than pairs.
pub struct Pairs {
    /// [primitives + 1] the first pair of each primitive
    pub starts: CubeTensor,
    /// `[pairs]` tile of every pair, or the number of tiles where the primitive does not touch it, or there is no pair
    pub tiles: CubeTensor,
    /// `[pairs]` of any value where there is no pair
    pub primitives: CubeTensor,
}

/// Columns and rows of the tiles of a rectangle.
#[cube]
fn tiles_of(rect: Rect) -> Rect {
    let filled = rect.is_filled();
    let (x0, y0) = (rect.x0 / TILE, rect.y0 / TILE);
    Rect { x0, x1: select(filled, rect.x1.div_ceil(TILE), x0), y0, y1: select(filled, rect.y1.div_ceil(TILE), y0) }
}

#[cube(launch)]
fn sizes_kernel(rects: &[u32], sizes: &mut [u32], count: u32) {
    let i = ABSOLUTE_POS;
    if i >= count as usize {
        terminate!();
    }
    // tiles that the primitive does not touch count, too: to test them here, one unit would visit all of a large one
    sizes[i] = tiles_of(Rect::load(rects, i)).area();
}

#[cube(launch)]
fn pairs_kernel(
    rects: &[u32],
    splats: &[f32],
    ends: &[f32],
    starts: &[u32],
    tiles: &mut [u32],
    primitives: &mut [u32],
    columns: u32,
    rows: u32,
    count: u32,
    room: u32,
    #[comptime] elliptic: bool,
) {
    let pair = ABSOLUTE_POS;
    let end = min(starts[count as usize], room);
    let i = own_owner(starts, count, end) as usize;
    if (pair as u32) < end {
        let touched = tiles_of(Rect::load(rects, i));
        let (column, row) = touched.pixel(pair as u32 - starts[i]);
        let tile = row * columns + column;
        let mut touches = true;
        if comptime!(elliptic) {
            let splat = Splat::load(splats, i * SPLAT);
            touches = splat.touches(column, row) && splat.depth < ends[tile as usize];
        }
        tiles[pair] = select(touches, tile, columns * rows);
        primitives[pair] = i as u32;
    } else if (pair as u32) < room {
        // sorted behind every list
        tiles[pair] = columns * rows;
    }
}

/// The first place of every tile in the sorted tiles of all pairs.
#[cube(launch)]
fn offsets_kernel(sorted: &[u32], offsets: &mut [u32], tiles: u32, count: u32) {
    let tile = ABSOLUTE_POS;
    if tile > tiles as usize {
        terminate!();
    }
    offsets[tile] = lower_bound(sorted, 0u32, count, tile as u32);
}

/// The list of a tile.
#[derive(CubeType, Clone, Copy)]
#[expand(derive(Clone, Copy))]
pub struct TileList {
    pub start: u32,
    pub length: u32,
}

#[cube]
impl TileList {
    /// The list of the tile of this cube, at most `count` primitives within `capacity`. It is uniform over the cube.
    pub fn own(offsets: &[u32], capacity: u32, count: u32) -> TileList {
        let mut range = Shared::<[u32]>::new_slice(2usize);
        if UNIT_POS == 0u32 {
            range[0] = min(offsets[CUBE_POS], capacity);
            range[1] = min(offsets[CUBE_POS + 1], capacity);
        }
        // WGSL allows barriers in a loop only if its bounds are uniform, which a load from a buffer is not
        let low = workgroup_uniform_load(&range[0]);
        let high = workgroup_uniform_load(&range[1]);
        TileList { start: low, length: min(high - low, count) }
    }

    /// Primitive at place `at` of the list.
    pub fn entry(&self, ids: &[u32], at: u32) -> u32 {
        ids[(self.start + at) as usize]
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
        // units may still read the batch before
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

/// Pairs of `rects` [N, 4] and the tiles of the image of `camera` and, of Gaussians, their `ellipses`.
pub fn pairs(rects: &CubeTensor, ellipses: Option<Ellipses>, camera: &Camera, kind: ListKind) -> Pairs {
    let (grid, count) = (TileGrid::new(camera.width, camera.height), rects.shape()[0]);
    let client = rects.client.clone();
    let sizes = empty_u32(rects, [count]);
    sizes_kernel::launch(&client, units(count), cube_dim(), buffer(rects), buffer(&sizes), count as u32);
    let starts = scan::starts(&sizes);
    let unused = empty_f32(rects, [1]);
    let elliptic = ellipses.is_some();
    let (splats, ends) = ellipses.map_or((&unused, &unused), |e| (e.splats, e.ends));
    let ((tiles, primitives), places) = capacity::with_room(&starts, kind, grid.len(), |room| {
        let (tiles, primitives) = (empty_u32(rects, [room]), empty_u32(rects, [room]));
        pairs_kernel::launch(
            &client,
            units(room),
            cube_dim(),
            buffer(rects),
            buffer(splats),
            buffer(ends),
            buffer(&starts),
            buffer(&tiles),
            buffer(&primitives),
            grid.columns as u32,
            grid.rows as u32,
            count as u32,
            u32::try_from(room).expect("a buffer of 32-bit numbers"),
            elliptic,
        );
        (tiles, primitives)
    });
    Pairs { starts, tiles: first_of(&tiles, places), primitives: first_of(&primitives, places) }
}

impl Pairs {
    /// `values` `[pairs]` by tile, those of no tile last, and [tiles + 1] the first of each tile. Those of one tile keep
    /// their order.
    pub fn by_tile(&self, values: &CubeTensor, grid: TileGrid) -> (CubeTensor, CubeTensor) {
        by_tile(self.tiles.clone(), values.clone(), grid)
    }
}

/// `values` `[pairs]` by the `tiles` of their pairs, see [`Pairs::by_tile`].
pub fn by_tile(tiles: CubeTensor, values: CubeTensor, grid: TileGrid) -> (CubeTensor, CubeTensor) {
    // the number of tiles is a key, too
    let bits = usize::BITS - grid.len().leading_zeros();
    let (sorted, values) = sorted_pairs(tiles, values, bits);
    let offsets = empty_u32(&values, [grid.len() + 1]);
    offsets_kernel::launch(
        &values.client.clone(),
        units(grid.len() + 1),
        cube_dim(),
        buffer(&sorted),
        buffer(&offsets),
        grid.len() as u32,
        values.shape()[0] as u32,
    );
    (values, offsets)
}

/// Lists of all tiles of the image of `camera`, for `rects` [N, 4] and, of Gaussians, their `ellipses`.
pub fn bin(rects: &CubeTensor, ellipses: Option<Ellipses>, camera: &Camera, kind: ListKind) -> CubeLists {
    let pairs = pairs(rects, ellipses, camera, kind);
    let (ids, offsets) = pairs.by_tile(&pairs.primitives, TileGrid::new(camera.width, camera.height));
    let capacity = ids.shape()[0] as u32;
    CubeLists { offsets, ids, capacity }
}
