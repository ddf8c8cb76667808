//! Pixels that do not count.

use cubecl::prelude::*;

/// Whether a pixel counts: all do unless the images are `masked`, by `ignored` [1, H, W] that is above 0.5 where one does not.
#[cube]
pub fn counts(ignored: &[f32], pixel: usize, #[comptime] masked: bool) -> bool {
    let mut counts = true;
    // compiled for one of both: without a mask the buffer holds nothing
    if comptime!(masked) {
        counts = ignored[pixel] <= 0.5f32;
    }
    counts
}
