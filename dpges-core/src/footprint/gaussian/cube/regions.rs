//! Which regions of a tile an ellipse reaches, so that the units of a region visit only the entries of a batch that can
//! draw there.

use cubecl::prelude::*;

use super::Splat;
use crate::gpu::launch::UNITS;
use crate::gpu::record::Record;
use crate::gpu::tile::{REGION_COLUMNS, REGION_HEIGHT, REGION_WIDTH, REGIONS, TILE};
use crate::gpu::view::CameraUniforms;

/// Numbers that hold a bit for each entry of a batch.
pub const WORDS: usize = UNITS as usize / 32;

/// For every entry of a batch the regions of a tile that it can draw in: bit r of its mask stands for
/// region r. The footprints begin the records of `stride` numbers in `staged`; `ends` [[`REGIONS`]] are the depths at
/// and behind which nothing is visible. All units of the cube must call this together.
#[cube]
pub fn mark_regions(
    staged: &[f32],
    entries: u32,
    ends: &[f32],
    masks: &mut [u32],
    tile: u32,
    view: CameraUniforms,
    #[comptime] stride: usize,
) {
    let mut mask = 0u32;
    if UNIT_POS < entries {
        let splat = Splat::load(staged, UNIT_POS as usize * stride);
        let (left, top) = (tile % view.columns * TILE, tile / view.columns * TILE);
        #[unroll]
        for region in 0..REGIONS {
            let across = comptime!(region as u32 % REGION_COLUMNS * REGION_WIDTH);
            let down = comptime!(region as u32 / REGION_COLUMNS * REGION_HEIGHT);
            let end = ends[comptime!(region)];
            // one unit tests an entry for all regions, in place of every pixel for itself
            let seen = splat.depth < end && splat.reaches(left + across, top + down, REGION_WIDTH, REGION_HEIGHT);
            mask |= select(seen, comptime!(1u32 << region), 0u32);
        }
    }
    masks[UNIT_POS as usize] = mask;
    sync_cube();
}

/// For every region the entries of a batch that it must visit: bit b of number [region, w] of `visits` stands for
/// entry 32 w + b. All units of the cube must call this together.
#[cube]
pub fn list_regions(masks: &[u32], visits: &mut [u32]) {
    if UNIT_POS < comptime!((REGIONS * WORDS) as u32) {
        let (region, word) = (UNIT_POS / WORDS as u32, UNIT_POS % WORDS as u32);
        let mut bits = 0u32;
        for step in 0..32u32 {
            // units of one region begin at different banks of the memory
            let bit = (step + word) % 32u32;
            bits |= ((masks[(word * 32u32 + bit) as usize] >> region) & 1u32) << bit;
        }
        visits[UNIT_POS as usize] = bits;
    }
    sync_cube();
}
