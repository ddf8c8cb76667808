//! The gather: [`LANES`] units go over the pixels of one primitive, a cube over those of [`GATHERED`]
//! primitives, so that nothing is accumulated across cubes.
//!
//! A kernel that gathers ends surplus cubes, sets its numbers to zero with [`zeros`], goes over every
//! [`LANES`]-th pixel of the rectangle of its primitive ([`primitive`]) from its [`lane`] on, and leaves
//! the rest to [`total`] or [`largest`].

use cubecl::prelude::*;

use super::launch::{GATHERED, LANES, UNITS};

/// Index of the primitive that this unit gathers for.
#[cube]
pub fn primitive() -> usize {
    CUBE_POS * GATHERED + (UNIT_POS / LANES) as usize
}

/// Which of the units of its primitive this is.
#[cube]
pub fn lane() -> u32 {
    UNIT_POS % LANES
}

#[cube]
pub fn zeros(#[comptime] numbers: usize) -> Array<f32> {
    let mut own = Array::<f32>::new(numbers);
    #[unroll]
    for number in 0..numbers {
        own[number] = 0.0f32;
    }
    own
}

/// One number of one primitive, which this unit is to write where it is `present`.
#[derive(CubeType, Clone, Copy)]
#[expand(derive(Clone, Copy))]
pub struct Gathered {
    pub present: bool,
    pub primitive: usize,
    pub number: usize,
    pub value: f32,
}

#[cube]
fn fold(own: &Array<f32>, count: u32, #[comptime] numbers: usize, #[comptime] sum: bool) -> Gathered {
    let mut partial = Shared::<[f32]>::new_slice(comptime!(UNITS as usize * numbers));
    let unit = UNIT_POS as usize;
    #[unroll]
    for number in 0..numbers {
        partial[unit * numbers + number] = own[number];
    }
    sync_cube();
    let (slot, number) = (unit / numbers, unit % numbers);
    let primitive = CUBE_POS * GATHERED + slot;
    let present = slot < GATHERED && primitive < count as usize;
    let mut value = 0.0f32;
    if present {
        for lane in 0..LANES {
            let part = partial[(slot * LANES as usize + lane as usize) * numbers + number];
            if comptime!(sum) {
                value += part;
            } else {
                value = max(value, part);
            }
        }
    }
    Gathered { present, primitive, number, value }
}

/// Sums of the numbers of all units of a primitive, in the order of the lanes.
#[cube]
pub fn total(own: &Array<f32>, count: u32, #[comptime] numbers: usize) -> Gathered {
    fold(own, count, numbers, true)
}

/// The largest of the numbers, none of which is negative, of all units of a primitive.
#[cube]
pub fn largest(own: &Array<f32>, count: u32, #[comptime] numbers: usize) -> Gathered {
    fold(own, count, numbers, false)
}
