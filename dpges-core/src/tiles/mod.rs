//! Parts of an image: square tiles, groups of lanes within a tile, rectangles of pixels, and horizontal bands.

pub(crate) mod bands;
pub mod binning;
pub(crate) mod capacity;
pub(crate) mod layout;
pub mod lists;

use pulp::Simd;

use crate::backend::lanes::Lanes;
use crate::backend::real::Real;

/// Edge of a square tile, px.
// a unit for each pixel makes 256, the largest workgroup that WebGPU guarantees
pub(crate) const TILE: usize = 16;
pub(crate) const TILE_PIXELS: usize = TILE * TILE;
/// Size of the regions of a tile, px: GPU kernels ask the pixels of a region together about a Gaussian, or none of them.
pub(crate) const REGION_WIDTH: usize = 8;
pub(crate) const REGION_HEIGHT: usize = 4;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct TileGrid {
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

    /// First pixel column and row of a tile.
    pub fn origin(&self, tile: usize) -> (usize, usize) {
        (tile % self.columns * TILE, tile / self.columns * TILE)
    }
}

/// Half-open rectangle of pixels whose centres a primitive can reach.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct PixelRect {
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
        // `f64 as u32` saturates, and `max` drops NaN
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

/// Calls `visit(start, dx, dy)` for every group of pixels of a tile, as wide as the vectors of `S`, that reaches into `rect`:
/// position of the group within the tile and offsets of its pixels from `anchor`, px.
#[inline(always)]
pub(crate) fn for_each_lanes<T: Real, S: Simd>(
    simd: S,
    anchor: [T; 2],
    rect: &PixelRect,
    origin: (usize, usize),
    mut visit: impl FnMut(usize, Lanes<T, S>, T),
) {
    let count = T::lane_count::<S>();
    let [x0, x1, y0, y1] = rect.within_tile(origin);
    let offset = |axis: usize, first: usize| T::of(first as f64 + 0.5) - anchor[axis];
    let (groups, left, top) = (x0 / count..x1.div_ceil(count), offset(0, origin.0), offset(1, origin.1));
    let lanes: [T; TILE] = std::array::from_fn(|column| T::of(column as f64));
    // groups outside and lines inside, so that the offsets in x are computed once for all lines
    for group in groups {
        let dx = Lanes::splat(simd, left) + Lanes::load(simd, &lanes[group * count..]);
        for line in y0..y1 {
            visit(line * TILE + group * count, dx, top + T::of(line as f64));
        }
    }
}

/// Offset from `anchor`, px, of the pixel at position `at` of a tile.
#[inline(always)]
pub(crate) fn pixel_offset<T: Real>(anchor: [T; 2], origin: (usize, usize), at: usize) -> [T; 2] {
    let offset = |axis: usize, first: usize| T::of(first as f64 + 0.5) - anchor[axis];
    [offset(0, origin.0 + at % TILE), offset(1, origin.1 + at / TILE)]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rectangles_cover_pixel_centres_and_clip_to_the_image() {
        let rect = PixelRect::covering([2.6, 4.4, -3.0, 100.0], 10, 8);
        assert_eq!(rect, PixelRect { x0: 3, x1: 4, y0: 0, y1: 8 });
        assert!(PixelRect::covering([2.6, 3.4, 0.0, 1.0], 10, 8).is_empty());
        let everywhere = PixelRect::covering([f64::NAN, f64::INFINITY, f64::NEG_INFINITY, f64::NAN], 10, 8);
        assert_eq!(everywhere, PixelRect { x0: 0, x1: 10, y0: 0, y1: 8 });
    }
}
