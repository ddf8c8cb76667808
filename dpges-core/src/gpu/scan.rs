//! Prefix sums of unsigned numbers, in one launch up to a block and in two beyond: the sums of all blocks, then the sums
//! within each, for which every cube adds up the blocks before its own by itself. That is quadratic work in the number of
//! blocks; so many that it would show are scanned by launches of their own.
//!
//! Sums that exceed 32 bits stay at the largest number, so that no sum wraps around to a small one, and whichever are
//! added first, the result is the same.

use burn::backend::TensorMetadata;
use burn_cubecl::tensor::CubeTensor;
use cubecl::prelude::*;

use super::launch::{UNITS, buffer, cube_dim, cubes, empty_u32};

/// Numbers that a unit adds one after the other.
const PER_UNIT: usize = 8;
/// Numbers of a cube.
const BLOCK: usize = PER_UNIT * UNITS as usize;
/// Most blocks whose sums every cube adds up by itself: those of 2²⁴ numbers, 32 for each unit.
const MOST_BLOCKS: usize = 8192;
/// Units that one unit scans for, and the number of such groups.
const GROUP: usize = 16;
const _: () = assert!(GROUP * GROUP == UNITS as usize);
/// Numbers of workgroup memory that [`scan_units`] needs.
pub const SCAN: usize = UNITS as usize + GROUP;

/// a + b, at most the largest number.
#[cube]
fn plus(a: u32, b: u32) -> u32 {
    // unsigned sums wrap around on devices, which shows by a sum below its summands
    let sum = a + b;
    select(sum < a, u32::MAX, sum)
}

/// The sum of the numbers of all units before this one, and that of all units.
#[derive(CubeType, Clone, Copy)]
#[expand(derive(Clone, Copy))]
pub struct Scanned {
    pub before: u32,
    pub total: u32,
}

/// Scans one number of each unit of the cube. All units must call this together; `memory` holds [`SCAN`] numbers,
/// and is free again afterwards.
#[cube]
pub fn scan_units(own: u32, memory: &mut [u32]) -> Scanned {
    let unit = UNIT_POS as usize;
    memory[unit] = own;
    sync_cube();
    // two levels of 16 need three barriers, where doubling steps would need eight
    if unit < GROUP {
        let mut sum = 0u32;
        for member in 0..GROUP {
            let at = unit * GROUP + member;
            let value = memory[at];
            memory[at] = sum;
            sum = plus(sum, value);
        }
        memory[UNITS as usize + unit] = sum;
    }
    sync_cube();
    let mut before = memory[unit];
    let mut total = 0u32;
    for group in 0..GROUP {
        let sum = memory[UNITS as usize + group];
        before = plus(before, select(group < unit / GROUP, sum, 0u32));
        total = plus(total, sum);
    }
    sync_cube();
    Scanned { before, total }
}

/// The values of a unit, whose first is at `first`; 0 beyond `count`.
#[cube]
fn own_values(values: &[u32], first: usize, count: u32) -> Array<u32> {
    let mut own = Array::<u32>::new(PER_UNIT);
    let last = max(count, 1u32) as usize - 1;
    #[unroll]
    for number in 0..PER_UNIT {
        let at = first + number;
        // at a place that is clamped, since loads behind a condition wait for one another
        own[number] = select(at < count as usize, values[min(at, last)], 0u32);
    }
    own
}

#[cube]
fn sum_of(own: &Array<u32>) -> u32 {
    let mut sum = 0u32;
    #[unroll]
    for number in 0..PER_UNIT {
        sum = plus(sum, own[number]);
    }
    sum
}

/// The sum of every block.
#[cube(launch)]
fn sums_kernel(values: &[u32], sums: &mut [u32], count: u32) {
    if CUBE_POS * BLOCK >= count as usize {
        terminate!();
    }
    let mut memory = Shared::<[u32]>::new_slice(SCAN);
    let first = CUBE_POS * BLOCK + UNIT_POS as usize * PER_UNIT;
    let sum = scan_units(sum_of(&own_values(values, first, count)), &mut memory);
    if UNIT_POS == 0u32 {
        sums[CUBE_POS] = sum.total;
    }
}

/// Knowledge of the blocks before one.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
enum Before {
    /// There is one block.
    Nothing,
    /// The sum of each of them.
    Sums,
    /// The sum of all of them.
    Total,
}

/// `starts` [count + 1]: for every value the sum of those before it, and last the sum of all. `blocks` has, by the number of
/// the block, what `known` says.
#[cube(launch)]
fn starts_kernel(values: &[u32], blocks: &[u32], starts: &mut [u32], count: u32, #[comptime] known: Before) {
    // a cube without values writes the sum of none
    if CUBE_POS * BLOCK >= max(count, 1u32) as usize {
        terminate!();
    }
    let mut memory = Shared::<[u32]>::new_slice(SCAN);
    let mut before = 0u32;
    if comptime!(known == Before::Sums) {
        let mut own = 0u32;
        let mut block = UNIT_POS as usize;
        while block < CUBE_POS {
            own = plus(own, blocks[block]);
            block += UNITS as usize;
        }
        before = scan_units(own, &mut memory).total;
    }
    if comptime!(known == Before::Total) {
        before = blocks[CUBE_POS];
    }
    let first = CUBE_POS * BLOCK + UNIT_POS as usize * PER_UNIT;
    let own = own_values(values, first, count);
    let mut sum = plus(before, scan_units(sum_of(&own), &mut memory).before);
    #[unroll]
    for number in 0..PER_UNIT {
        let at = first + number;
        if at <= count as usize {
            starts[at] = sum;
        }
        sum = plus(sum, own[number]);
        // the end of the last unit of the last block has no place within the block
        let last_of_unit = comptime!(number + 1 == PER_UNIT);
        if last_of_unit && at + 1 == count as usize {
            starts[at + 1] = sum;
        }
    }
}

/// [n + 1] sums of the numbers before each of `values` `[n]`, and of all of them.
pub fn starts(values: &CubeTensor) -> CubeTensor {
    let (client, count) = (values.client.clone(), values.shape()[0]);
    let blocks = count.div_ceil(BLOCK);
    let (of_blocks, known) = if blocks <= 1 {
        (empty_u32(values, [1]), Before::Nothing)
    } else {
        let sums = empty_u32(values, [blocks]);
        sums_kernel::launch(&client, cubes(blocks), cube_dim(), buffer(values), buffer(&sums), count as u32);
        if blocks <= MOST_BLOCKS { (sums, Before::Sums) } else { (starts(&sums), Before::Total) }
    };
    let out = empty_u32(values, [count + 1]);
    starts_kernel::launch(
        &client,
        cubes(blocks),
        cube_dim(),
        buffer(values),
        buffer(&of_blocks),
        buffer(&out),
        count as u32,
        known,
    );
    out
}
