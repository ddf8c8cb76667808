//! Rectangles of pixels in buffers of kernels.

use cubecl::prelude::*;

/// Number of values in a [`Rect`].
pub const RECT: usize = 4;

/// Columns and rows of pixels, half open.
#[derive(CubeType, Clone, Copy)]
#[expand(derive(Clone, Copy))]
pub struct Rect {
    pub x0: u32,
    pub x1: u32,
    pub y0: u32,
    pub y1: u32,
}

#[cube]
impl Rect {
    /// Reads row `i` of a [N, [`RECT`]] buffer.
    pub fn load(rects: &[u32], i: usize) -> Rect {
        let o = i * RECT;
        Rect { x0: rects[o], x1: rects[o + 1], y0: rects[o + 2], y1: rects[o + 3] }
    }

    /// Writes row `i` of a [N, [`RECT`]] buffer.
    pub fn store(&self, rects: &mut [u32], i: usize) {
        let o = i * RECT;
        rects[o] = self.x0;
        rects[o + 1] = self.x1;
        rects[o + 2] = self.y0;
        rects[o + 3] = self.y1;
    }

    /// Whether it has pixels.
    pub fn is_filled(&self) -> bool {
        self.x0 < self.x1 && self.y0 < self.y1
    }

    /// Number of pixels.
    pub fn area(&self) -> u32 {
        // ends may lie before beginnings, and unsigned differences would wrap around
        select(self.is_filled(), (self.x1 - self.x0) * (self.y1 - self.y0), 0u32)
    }

    /// Column and row of the pixel `at`, counted line by line.
    pub fn pixel(&self, at: u32) -> (u32, u32) {
        let width = self.x1 - self.x0;
        (self.x0 + at % width, self.y0 + at / width)
    }
}
