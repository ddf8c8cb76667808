//! The smallest rectangle around the pixels in which a surfel is a layer, found with integer atomics. GPU
//! kernels gather gradients over these rectangles, in pieces.

use std::sync::{Mutex, PoisonError};

use burn::backend::TensorMetadata;
use burn_cubecl::tensor::CubeTensor;
use cubecl::prelude::*;

use crate::gpu::launch::{buffer, cube_dim, empty_u32, units, zeros_u32};
use crate::gpu::rect::{RECT, Rect};
use crate::gpu::work_split::{WorkSplit, split_work};

/// Records how far the rectangle of a surfel reaches, at the pixels where a run of the surfel begins or ends.
/// Left and top are distances from the far side of the image, so that 0 means that nothing was recorded.
#[cube(launch)]
fn extremes_kernel(ids: &[i32], extremes: &[Atomic<u32>], width: u32, height: u32, count: u32) {
    let at = ABSOLUTE_POS;
    if at >= count as usize {
        terminate!();
    }
    let pixel = at as u32 % (width * height);
    let (x, y) = (pixel % width, pixel / width);
    let id = ids[at];
    if id >= 0i32 {
        let o = id as usize * RECT;
        // only the ends of a run can be extremes; atomics at the pixels between would make units wait for nothing
        let mut first = x == 0u32;
        let mut last = x + 1u32 == width;
        let mut top = y == 0u32;
        let mut bottom = y + 1u32 == height;
        if x > 0u32 {
            first = ids[at - 1] != id;
        }
        if x + 1u32 < width {
            last = ids[at + 1] != id;
        }
        if y > 0u32 {
            top = ids[at - width as usize] != id;
        }
        if y + 1u32 < height {
            bottom = ids[at + width as usize] != id;
        }
        // integer maxima come out the same whichever unit is first
        if first {
            extremes[o].fetch_max(width - x);
        }
        if last {
            extremes[o + 1].fetch_max(x + 1u32);
        }
        if top {
            extremes[o + 2].fetch_max(height - y);
        }
        if bottom {
            extremes[o + 3].fetch_max(y + 1u32);
        }
    }
}

#[cube(launch)]
fn boxes_kernel(extremes: &[u32], boxes: &mut [u32], width: u32, height: u32, count: u32) {
    let i = ABSOLUTE_POS;
    if i >= count as usize {
        terminate!();
    }
    let reached = Rect::load(extremes, i);
    // a surfel that is no layer reaches from 0 to 0
    let seen = reached.x1 > 0u32;
    let (x0, y0) = (select(seen, width - reached.x0, 0u32), select(seen, height - reached.y0, 0u32));
    Rect { x0, x1: reached.x1, y0, y1: reached.y1 }.store(boxes, i);
}

/// [count, [`RECT`]] rectangles around the pixels of `ids` [K, H, W] that belong to each surfel.
fn visible_boxes(ids: &CubeTensor, count: usize) -> CubeTensor {
    let [layers, height, width] = ids.shape().dims();
    let extremes = zeros_u32(ids, [count.max(1), RECT]);
    let pixels = layers * height * width;
    extremes_kernel::launch(
        &ids.client.clone(),
        units(pixels),
        cube_dim(),
        buffer(ids),
        buffer(&extremes),
        width as u32,
        height as u32,
        pixels as u32,
    );
    let boxes = empty_u32(ids, [count, RECT]);
    boxes_kernel::launch(
        &ids.client.clone(),
        units(count),
        cube_dim(),
        buffer(&extremes),
        buffer(&boxes),
        width as u32,
        height as u32,
        count as u32,
    );
    boxes
}

/// Pieces of the boxes of `count` surfels in some layers.
struct Found {
    ids: CubeTensor,
    count: usize,
    pieces: WorkSplit,
}

impl Found {
    /// Whether these are the layers in the buffer of `ids`, which stays as it is as long as this holds it, too.
    fn is_of(&self, ids: &CubeTensor, count: usize) -> bool {
        let (own, other) = (&self.ids.handle, &ids.handle);
        own.memory.clone().binding().id() == other.memory.clone().binding().id()
            && (own.offset_start, self.ids.shape(), self.count) == (other.offset_start, ids.shape(), count)
    }
}

/// Rectangles that an operation found, for the next one that gathers over the same layers.
static FOUND: Mutex<Option<Found>> = Mutex::new(None);

/// Pieces of the boxes around the pixels of `ids` [K, H, W] that belong to each of `count` surfels. Compositing and peeling go
/// back over the same layers: what the first finds the second takes.
pub fn visible_pieces(ids: &CubeTensor, count: usize) -> WorkSplit {
    let mut last = FOUND.lock().unwrap_or_else(PoisonError::into_inner);
    // taken, not copied: nobody asks a third time, and the buffers are free for the next step
    if let Some(found) = last.take_if(|found| found.is_of(ids, count)) {
        return found.pieces;
    }
    let pieces = split_work(&visible_boxes(ids, count));
    *last = Some(Found { ids: ids.clone(), count, pieces: pieces.clone() });
    pieces
}
