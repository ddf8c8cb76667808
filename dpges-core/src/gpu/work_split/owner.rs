//! Work of different sizes in equal pieces. A primitive has as many pieces as its size asks for, and pieces have
//! consecutive numbers in the order of the primitives: `starts` [primitives + 1] holds the first of each.

use cubecl::prelude::*;

use crate::gpu::launch::UNITS;

/// The primitive in [low, high) that a piece belongs to: the last that starts at or before it. The piece must belong
/// to one of them.
#[cube]
fn owner_in(starts: &[u32], low: u32, high: u32, piece: u32) -> u32 {
    let mut first = low;
    let mut end = high;
    while end - first > 1u32 {
        let middle = (first + end) / 2u32;
        // `<=` finds the last of several equal starts: the primitives before it have no pieces
        if starts[middle as usize] <= piece {
            first = middle;
        } else {
            end = middle;
        }
    }
    first
}

/// The primitive, of `count`, that the piece with the number of this unit belongs to, if the number is below `end`. All
/// units of the cube must call this together.
#[cube]
pub fn own_owner(starts: &[u32], count: u32, end: u32) -> u32 {
    let mut range = Shared::<[u32]>::new_slice(2usize);
    let piece = ABSOLUTE_POS as u32;
    let base = piece - UNIT_POS;
    // those of the first and of the last unit bound the others
    if UNIT_POS < 2u32 && base < end {
        let bound = select(UNIT_POS == 0u32, base, min(base + UNITS, end) - 1u32);
        range[UNIT_POS as usize] = owner_in(starts, 0u32, count, bound);
    }
    sync_cube();
    let mut owner = 0u32;
    if piece < end {
        owner = owner_in(starts, range[0], range[1] + 1u32, piece);
    }
    owner
}

/// The first of ascending `values` in [low, high) that is not below `bound`, or `high`.
#[cube]
pub fn lower_bound(values: &[u32], low: u32, high: u32, bound: u32) -> u32 {
    let mut first = low;
    let mut end = high;
    while first < end {
        let middle = (first + end) / 2u32;
        if values[middle as usize] < bound {
            first = middle + 1u32;
        } else {
            end = middle;
        }
    }
    first
}
