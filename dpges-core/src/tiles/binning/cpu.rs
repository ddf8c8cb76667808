//! CPU binning: count, prefix sum and fill, in chunks of primitives.

use std::sync::atomic::{AtomicU32, Ordering};

use rayon::prelude::*;

use crate::tiles::capacity::{exceed, too_many_entries};
use crate::tiles::{PixelRect, TileGrid};

/// Primitives of one task.
const CHUNK: usize = 4096;
/// Most entries of all lists together: they are counted in 32 bits.
const MOST: u64 = u32::MAX as u64;

/// Lists of primitives, one per tile.
#[derive(Clone, Debug)]
pub struct TileLists {
    offsets: Vec<u32>,
    ids: Vec<u32>,
}

impl TileLists {
    /// Primitives of `tile`, ascending.
    pub fn of(&self, tile: usize) -> &[u32] {
        &self.ids[self.offsets[tile] as usize..self.offsets[tile + 1] as usize]
    }
}

/// Calls `visit(tile)` for every tile a primitive touches; used for both counting and filling.
#[inline(always)]
fn for_each_tile(
    rect: &PixelRect,
    grid: TileGrid,
    touches: impl Fn(usize, usize) -> bool,
    mut visit: impl FnMut(usize),
) {
    let [tx0, tx1, ty0, ty1] = rect.tiles();
    for ty in ty0..ty1 {
        for tx in tx0..tx1 {
            if touches(tx, ty) {
                visit(ty * grid.columns + tx);
            }
        }
    }
}

/// Exclusive prefix sum over (tile, chunk) of `counts` [chunks, tiles], which become the places where each chunk begins to
/// write in each tile. Returns [tiles + 1] the first place of each tile.
fn offsets(counts: &mut [Vec<u32>], tiles: usize) -> Vec<u32> {
    let mut offsets = Vec::with_capacity(tiles + 1);
    let mut total = 0u32;
    for tile in 0..tiles {
        offsets.push(total);
        // chunks in their order keep the list of a tile ascending, whatever thread fills it first
        for chunk in counts.iter_mut() {
            let count = chunk[tile];
            chunk[tile] = total;
            total += count;
        }
    }
    offsets.push(total);
    offsets
}

/// Lists for all tiles of `grid`. `touches(primitive, tile column, tile row)` may exclude tiles inside the rectangle that
/// the primitive cannot reach. [Exceeds](exceed) the capacity if the lists have 2³² entries or more.
pub fn bin(rects: &[PixelRect], grid: TileGrid, touches: impl Fn(usize, usize, usize) -> bool + Sync) -> TileLists {
    let tiles = grid.len();
    let mut counts: Vec<Vec<u32>> = rects
        .par_chunks(CHUNK)
        .enumerate()
        .map(|(chunk, rects)| {
            let mut counts = vec![0u32; tiles];
            for (i, rect) in rects.iter().enumerate() {
                for_each_tile(rect, grid, |tx, ty| touches(chunk * CHUNK + i, tx, ty), |tile| counts[tile] += 1);
            }
            counts
        })
        .collect();
    // in 64 bits: a chunk adds at most `CHUNK` entries to a tile, but all together may exceed 32 bits
    let entries: u64 = counts.par_iter().map(|counts| counts.iter().map(|&count| u64::from(count)).sum::<u64>()).sum();
    if entries > MOST {
        exceed(too_many_entries(rects.len(), entries, MOST * size_of::<u32>() as u64));
    }
    let offsets = offsets(&mut counts, tiles);
    // every place has one writer; relaxed atomics say so without `unsafe`, and cost what plain stores do
    let ids: Vec<AtomicU32> = (0..entries).map(|_| AtomicU32::new(0)).collect();
    rects.par_chunks(CHUNK).zip(counts).enumerate().for_each(|(chunk, (rects, mut cursor))| {
        for (i, rect) in rects.iter().enumerate() {
            let id = chunk * CHUNK + i;
            for_each_tile(
                rect,
                grid,
                |tx, ty| touches(id, tx, ty),
                |tile| {
                    ids[cursor[tile] as usize].store(id as u32, Ordering::Relaxed);
                    cursor[tile] += 1;
                },
            );
        }
    });
    TileLists { offsets, ids: ids.into_iter().map(AtomicU32::into_inner).collect() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::error::Error;
    use crate::testing::random::Random;
    use crate::tiles::capacity::within_capacity;

    #[test]
    fn more_entries_than_32_bits_count_are_refused() {
        let grid = TileGrid::new(8192, 8192);
        let all = PixelRect { x0: 0, x1: 8192, y0: 0, y1: 8192 };
        // 2¹⁴ times 2¹⁸ tiles
        let error = within_capacity(|| bin(&vec![all; 1 << 14], grid, |_, _, _| true)).unwrap_err();
        assert!(matches!(error, Error::Capacity { needed: 0x4_0000_0000, .. }), "{error}");
    }

    #[test]
    fn every_primitive_is_listed_once_in_each_tile_it_touches_and_in_order() {
        let grid = TileGrid::new(75, 50);
        let mut random = Random::new(1);
        let mut below = |count: usize| random.below(count) as u32;
        let mut rect = || {
            let (x0, y0) = (below(75), below(50));
            PixelRect { x0, x1: (x0 + below(30)).min(75), y0, y1: (y0 + 1 + below(30)).min(50) }
        };
        let rects: Vec<_> = (0..10_000).map(|_| rect()).collect();
        let lists = bin(&rects, grid, |id, tx, _| id % 3 != 0 || tx % 2 == 0);
        for tile in 0..grid.len() {
            let (x, y) = grid.origin(tile);
            let is_listed = |&id: &u32| {
                let rect = rects[id as usize];
                let [cx0, cx1, cy0, cy1] = rect.within_tile((x, y));
                let touches = id % 3 != 0 || (tile % grid.columns).is_multiple_of(2);
                !rect.is_empty() && cx0 < cx1 && cy0 < cy1 && touches
            };
            assert_eq!(lists.of(tile), (0..10_000).filter(is_listed).collect::<Vec<u32>>());
        }
    }
}
