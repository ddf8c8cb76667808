//! Sums over the units of a cube, and over what cubes leave in a buffer, always in the same order.

use cubecl::prelude::*;

use super::gather::zeros;
use super::launch::{HALVINGS, UNITS};

/// Cubes that share the work of a sum over any number of items. A cube can add up what they leave, one part per unit.
pub fn parts(items: usize) -> usize {
    items.div_ceil(UNITS as usize).clamp(1, UNITS as usize)
}

/// Adds up the numbers of all units of the cube: the sums are the first `numbers` of `memory`, which holds [`UNITS`] times
/// as many, and whose contents before are lost. All units of the cube must call this together.
#[cube]
pub fn sum_units(own: &Array<f32>, memory: &mut [f32], #[comptime] numbers: usize) {
    let unit = UNIT_POS as usize;
    let first = unit * numbers;
    // other units may still read what was there
    sync_cube();
    #[unroll]
    for number in 0..numbers {
        memory[first + number] = own[number];
    }
    #[unroll]
    for halving in 0..HALVINGS {
        // a tree: a fixed order, and errors that grow with the logarithm of the number of units
        let step = comptime!((UNITS >> (halving + 1)) as usize);
        sync_cube();
        if unit < step {
            #[unroll]
            for number in 0..numbers {
                let other = memory[first + step * numbers + number];
                memory[first + number] += other;
            }
        }
    }
    sync_cube();
}

/// [`sum_units`] for the largest number of all units: it is the first of `memory`, which holds [`UNITS`].
#[cube]
pub fn max_units(own: f32, memory: &mut [f32]) {
    let unit = UNIT_POS as usize;
    // other units may still read what was there
    sync_cube();
    memory[unit] = own;
    #[unroll]
    for halving in 0..HALVINGS {
        let step = comptime!((UNITS >> (halving + 1)) as usize);
        sync_cube();
        if unit < step {
            memory[unit] = max(memory[unit], memory[unit + step]);
        }
    }
    sync_cube();
}

/// Adds up `parts` [count, `numbers`] by the units of one cube, into `memory` as [`sum_units`] does.
#[cube]
pub fn sum_parts(parts: &[f32], count: u32, memory: &mut [f32], #[comptime] numbers: usize) {
    let mut own = zeros(numbers);
    let mut part = UNIT_POS;
    while part < count {
        #[unroll]
        for number in 0..numbers {
            own[number] += parts[part as usize * numbers + number];
        }
        part += UNITS;
    }
    sum_units(&own, memory, numbers);
}
