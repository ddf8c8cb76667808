//! Gathering: [`LANES`] units visit the pixels of one primitive and a cube serves [`GATHERED`] primitives, so
//! that no sum crosses cubes.
//!
//! Every kernel that gathers has the same steps. It terminates surplus cubes and starts from [`zeros`]. Each
//! unit visits every [`LANES`]-th pixel in the rectangle of its [`primitive`], beginning with its [`lane`].
//! [`total`] then adds up the units of a primitive.

use cubecl::prelude::*;

use super::launch::{GATHERED, LANES, UNITS};

/// Index of the primitive that this unit gathers for.
#[cube]
pub fn primitive() -> usize {
    CUBE_POS * GATHERED + (UNIT_POS / LANES) as usize
}

/// Position of this unit among those of its primitive.
#[cube]
pub fn lane() -> u32 {
    UNIT_POS % LANES
}

/// The numbers of a unit before its first pixel.
#[cube]
pub fn zeros(#[comptime] numbers: usize) -> Array<f32> {
    let mut own = Array::<f32>::new(numbers);
    #[unroll]
    for number in 0..numbers {
        own[number] = 0.0f32;
    }
    own
}

/// A number of a primitive. This unit writes it if it is `present`.
#[derive(CubeType, Clone, Copy)]
#[expand(derive(Clone, Copy))]
pub struct Gathered {
    pub present: bool,
    pub primitive: usize,
    pub number: usize,
    pub value: f32,
}

/// Adds the numbers of all units of a primitive, in the order of the lanes.
#[cube]
pub fn total(own: &Array<f32>, count: u32, #[comptime] numbers: usize) -> Gathered {
    // 16 KiB of workgroup memory, all that WebGPU guarantees, hold up to 16 numbers of each unit
    let mut partial = Shared::<[f32]>::new_slice(comptime!(UNITS as usize * numbers));
    let unit = UNIT_POS as usize;
    #[unroll]
    for number in 0..numbers {
        partial[unit * numbers + number] = own[number];
    }
    sync_cube();
    // a unit adds one number of one primitive, and one after the other: a fixed order gives the same bits in every run
    let (slot, number) = (unit / numbers, unit % numbers);
    let primitive = CUBE_POS * GATHERED + slot;
    let present = slot < GATHERED && primitive < count as usize;
    let mut value = 0.0f32;
    if present {
        for lane in 0..LANES {
            value += partial[(slot * LANES as usize + lane as usize) * numbers + number];
        }
    }
    Gathered { present, primitive, number, value }
}
