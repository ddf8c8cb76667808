//! Work of different sizes in equal pieces. A primitive has as many pieces as its size asks for, and pieces have
//! consecutive numbers in the order of the primitives: `starts` [primitives + 1] holds the first of each.

use cubecl::prelude::*;

/// The primitive in [low, high) that a piece belongs to: the last that starts at or before it. The piece must belong
/// to one of them.
#[cube]
pub fn owner(starts: &[u32], low: u32, high: u32, piece: u32) -> u32 {
    let mut first = low;
    let mut end = high;
    while end - first > 1u32 {
        let middle = (first + end) / 2u32;
        if starts[middle as usize] <= piece {
            first = middle;
        } else {
            end = middle;
        }
    }
    first
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
