//! Primitives → tiles: which primitives can touch which tile of the image, in ascending order of
//! index, by counting, prefix sum and fill.

#[cfg(feature = "gpu")]
pub(crate) mod cube;
pub mod layout;

use std::sync::atomic::{AtomicU32, Ordering};

use rayon::prelude::*;

/// Edge of a square tile, px.
pub const TILE: usize = 16;
/// Pixels of a tile.
pub const TILE_PIXELS: usize = TILE * TILE;
/// Pixels that kernels process together; a tile row is `TILE / LANES` groups.
pub const LANES: usize = 8;

const CHUNK: usize = 4096;

/// The tiles of an image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TileGrid {
    /// Image size, px.
    pub width: usize,
    pub height: usize,
    /// Number of tiles along each axis.
    pub columns: usize,
    pub rows: usize,
}

impl TileGrid {
    pub fn new(width: usize, height: usize) -> Self {
        Self { width, height, columns: width.div_ceil(TILE), rows: height.div_ceil(TILE) }
    }

    pub fn len(&self) -> usize {
        self.columns * self.rows
    }

    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// First pixel column and row of a tile.
    pub fn origin(&self, tile: usize) -> (usize, usize) {
        (tile % self.columns * TILE, tile / self.columns * TILE)
    }
}

/// Half-open rectangle of pixels whose centres a primitive can reach.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PixelRect {
    pub x0: u32,
    pub x1: u32,
    pub y0: u32,
    pub y1: u32,
}

impl PixelRect {
    pub const EMPTY: Self = Self { x0: 0, x1: 0, y0: 0, y1: 0 };

    /// Pixels with centres in [x_low, x_high] × [y_low, y_high] px, widened by `SLACK_PX` for
    /// rounding and clipped to the image. Bounds that are not numbers reach everywhere.
    pub fn covering(bounds: [f64; 4], width: usize, height: usize) -> Self {
        const SLACK_PX: f64 = 1e-3;
        let [x_low, x_high, y_low, y_high] = bounds;
        // `f64 as u32` saturates, and NaN falls to `max`'s other side
        let first = |low: f64| (low - 0.5 - SLACK_PX).ceil().max(0.0) as u32;
        let end = |high: f64, size: usize| ((high - 0.5 + SLACK_PX).floor() + 1.0).min(size as f64).max(0.0) as u32;
        let rect = Self { x0: first(x_low), x1: end(x_high, width), y0: first(y_low), y1: end(y_high, height) };
        if rect.x0 >= rect.x1 || rect.y0 >= rect.y1 { Self::EMPTY } else { rect }
    }

    pub fn is_empty(&self) -> bool {
        self.x0 >= self.x1
    }

    /// Tiles touched: columns and rows, half open.
    #[inline(always)]
    pub fn tiles(&self) -> [usize; 4] {
        if self.is_empty() {
            return [0; 4];
        }
        let tile = TILE as u32;
        [self.x0 / tile, (self.x1 - 1) / tile + 1, self.y0 / tile, (self.y1 - 1) / tile + 1].map(|v| v as usize)
    }

    /// The part inside the tile with this origin: columns and rows relative to it, half open.
    #[inline(always)]
    pub fn within_tile(&self, (x, y): (usize, usize)) -> [usize; 4] {
        let clip = |v: u32, origin: usize| (v as usize).saturating_sub(origin).min(TILE);
        [clip(self.x0, x), clip(self.x1, x), clip(self.y0, y), clip(self.y1, y)]
    }
}

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

/// Lists for all tiles of `grid`. `touches(primitive, tile column, tile row)` may exclude tiles
/// inside the rectangle that the primitive cannot reach.
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
    // exclusive prefix sum over (tile, chunk): each chunk then knows where to write in each tile
    let mut offsets = Vec::with_capacity(tiles + 1);
    let mut total = 0u32;
    for tile in 0..tiles {
        offsets.push(total);
        for chunk in &mut counts {
            let count = chunk[tile];
            chunk[tile] = total;
            total += count;
        }
    }
    offsets.push(total);
    let ids: Vec<AtomicU32> = (0..total).map(|_| AtomicU32::new(0)).collect();
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

    #[test]
    fn every_primitive_is_listed_once_in_each_tile_it_touches_and_in_order() {
        let grid = TileGrid::new(75, 50);
        let mut state = 1u32;
        let mut random = |below: u32| {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 8) % below
        };
        let rects: Vec<_> = (0..10_000)
            .map(|_| {
                let (x0, y0) = (random(75), random(50));
                PixelRect { x0, x1: (x0 + random(30)).min(75), y0, y1: (y0 + 1 + random(30)).min(50) }
            })
            .collect();
        let lists = bin(&rects, grid, |id, tx, _| id % 3 != 0 || tx % 2 == 0);
        for tile in 0..grid.len() {
            let (x, y) = grid.origin(tile);
            let expected: Vec<u32> = (0..rects.len())
                .filter(|&id| {
                    let [cx0, cx1, cy0, cy1] = rects[id].within_tile((x, y));
                    !rects[id].is_empty()
                        && cx0 < cx1
                        && cy0 < cy1
                        && (id % 3 != 0 || (tile % grid.columns).is_multiple_of(2))
                })
                .map(|id| id as u32)
                .collect();
            assert_eq!(lists.of(tile), expected);
        }
    }

    #[test]
    fn rectangles_cover_pixel_centres_and_clip_to_the_image() {
        let rect = PixelRect::covering([2.6, 4.4, -3.0, 100.0], 10, 8);
        assert_eq!(rect, PixelRect { x0: 3, x1: 4, y0: 0, y1: 8 });
        assert!(PixelRect::covering([2.6, 3.4, 0.0, 1.0], 10, 8).is_empty());
        let everywhere = PixelRect::covering([f64::NAN, f64::INFINITY, f64::NEG_INFINITY, f64::NAN], 10, 8);
        assert_eq!(everywhere, PixelRect { x0: 0, x1: 10, y0: 0, y1: 8 });
    }
}
