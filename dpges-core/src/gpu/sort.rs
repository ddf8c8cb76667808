//! A stable radix sort of (key, value) pairs of unsigned numbers, least significant digits first.
//!
//! A pass sorts by one digit. Cubes count the digits in their blocks, a prefix sum over (digit, block) says where each
//! block puts its first pair of each digit, and cubes sort their blocks in workgroup memory, four bits at a time, so
//! that pairs of the same digit leave together.

use burn::backend::TensorMetadata;
use burn_cubecl::tensor::CubeTensor;
use cubecl::prelude::*;

use super::launch::{UNITS, buffer, cube_dim, cubes, empty_u32};
use super::scan::{SCAN, scan_units, starts};

/// Pairs of a unit.
const PER_UNIT: usize = 4;
/// Pairs of a cube.
const BLOCK: usize = PER_UNIT * UNITS as usize;
/// Bits that a block is sorted by at a time, and counters for them: two of 16 bits in each number.
const NIBBLE: u32 = 4;
const COUNTERS: usize = (1 << NIBBLE) / 2;
/// A pair of a block: its place in the block, and its digit above.
const PLACE_BITS: u32 = BLOCK.ilog2();
const PLACE_MASK: u32 = BLOCK as u32 - 1;
/// Digits of two nibbles.
const MAX_RADIX: usize = 1 << (2 * NIBBLE);
const _: () = assert!(MAX_RADIX <= UNITS as usize);

#[cube]
fn digit_of(key: u32, shift: u32, #[comptime] radix: usize) -> u32 {
    let mask = comptime!(radix as u32 - 1);
    (key >> shift) & mask
}

/// How many pairs of every block have each digit: [radix, blocks].
#[cube(launch)]
fn count_kernel(keys: &[u32], counts: &mut [u32], count: u32, shift: u32, #[comptime] radix: usize) {
    let blocks = count.div_ceil(BLOCK as u32) as usize;
    if CUBE_POS >= blocks {
        terminate!();
    }
    let found = Shared::<[Atomic<u32>]>::new_slice(radix);
    let unit = UNIT_POS as usize;
    if unit < radix {
        found[unit].store(0u32);
    }
    sync_cube();
    #[unroll]
    for round in 0..PER_UNIT {
        let at = CUBE_POS * BLOCK + round * UNITS as usize + unit;
        if at < count as usize {
            // integers: counts do not depend on the order of the units
            found[digit_of(keys[at], shift, radix) as usize].fetch_add(1u32);
        }
    }
    sync_cube();
    if unit < radix {
        counts[unit * blocks + CUBE_POS] = found[unit].load();
    }
}

/// Sorts the items of a block by four bits of their digit. Equal ones keep their order.
#[cube]
fn sort_block(items: &mut [u32], counters: &mut [u32], memory: &mut [u32], shift: u32) {
    let unit = UNIT_POS as usize;
    let mut own = Array::<u32>::new(PER_UNIT);
    #[unroll]
    for counter in 0..COUNTERS {
        counters[counter * UNITS as usize + unit] = 0u32;
    }
    #[unroll]
    for number in 0..PER_UNIT {
        let item = items[unit * PER_UNIT + number];
        own[number] = item;
        let nibble = (item >> shift) & 15u32;
        counters[(nibble % 8u32) as usize * UNITS as usize + unit] += 1u32 << (nibble / 8u32 * 16u32);
    }
    sync_cube();
    // both halves are scanned at once; no block has so many items that one reaches into the other
    let mut sum = 0u32;
    #[unroll]
    for counter in 0..COUNTERS {
        let at = unit * COUNTERS + counter;
        let value = counters[at];
        counters[at] = sum;
        sum += value;
    }
    let scanned = scan_units(sum, memory);
    let before = scanned.before + (scanned.total << 16u32);
    #[unroll]
    for counter in 0..COUNTERS {
        counters[unit * COUNTERS + counter] += before;
    }
    sync_cube();
    // a unit places its own items one after the other, in their order: this makes the sort stable
    #[unroll]
    for number in 0..PER_UNIT {
        let item = own[number];
        let nibble = (item >> shift) & 15u32;
        let half = nibble / 8u32 * 16u32;
        let counter = (nibble % 8u32) as usize * UNITS as usize + unit;
        let place = (counters[counter] >> half) & 0xffffu32;
        counters[counter] += 1u32 << half;
        items[place as usize] = item;
    }
    sync_cube();
}

/// Puts the pairs of every block where `starts` [radix · blocks + 1] says.
#[cube(launch)]
fn scatter_kernel(
    keys: &[u32],
    values: &[u32],
    starts: &[u32],
    sorted_keys: &mut [u32],
    sorted_values: &mut [u32],
    count: u32,
    shift: u32,
    #[comptime] radix: usize,
) {
    let blocks = count.div_ceil(BLOCK as u32) as usize;
    if CUBE_POS >= blocks {
        terminate!();
    }
    let unit = UNIT_POS as usize;
    let base = CUBE_POS * BLOCK;
    // places and digits, not the pairs: with counters these take 14 of the 16 KiB that WebGPU guarantees
    let mut items = Shared::<[u32]>::new_slice(BLOCK);
    let mut counters = Shared::<[u32]>::new_slice(comptime!(COUNTERS * UNITS as usize));
    let mut memory = Shared::<[u32]>::new_slice(SCAN);
    let mut firsts = Shared::<[u32]>::new_slice(radix);
    #[unroll]
    for round in 0..PER_UNIT {
        let place = round * UNITS as usize + unit;
        // what lies beyond the end sorts last
        let present = base + place < count as usize;
        let key = keys[select(present, base + place, base)];
        let digit = select(present, digit_of(key, shift, radix), comptime!(radix as u32 - 1));
        items[place] = (digit << PLACE_BITS) | place as u32;
    }
    sync_cube();
    sort_block(&mut items, &mut counters, &mut memory, PLACE_BITS);
    if comptime!(radix > (1 << NIBBLE)) {
        sort_block(&mut items, &mut counters, &mut memory, comptime!(PLACE_BITS + NIBBLE));
    }
    #[unroll]
    for round in 0..PER_UNIT {
        let place = round * UNITS as usize + unit;
        let digit = items[place] >> PLACE_BITS;
        let mut leads = place == 0;
        if place > 0 {
            leads = items[place - 1] >> PLACE_BITS != digit;
        }
        if leads {
            firsts[digit as usize] = place as u32;
        }
    }
    sync_cube();
    #[unroll]
    for round in 0..PER_UNIT {
        let place = round * UNITS as usize + unit;
        let item = items[place];
        let from = base + (item & PLACE_MASK) as usize;
        if from < count as usize {
            let digit = (item >> PLACE_BITS) as usize;
            let to = starts[digit * blocks + CUBE_POS] + place as u32 - firsts[digit];
            sorted_keys[to as usize] = keys[from];
            sorted_values[to as usize] = values[from];
        }
    }
}

/// (keys, values) `[n]` in ascending order of the lowest `bits` of the keys; equal ones keep their order.
pub fn sorted_pairs(keys: CubeTensor, values: CubeTensor, bits: u32) -> (CubeTensor, CubeTensor) {
    let (client, count) = (keys.client.clone(), keys.shape()[0]);
    let (mut keys, mut values) = (keys, values);
    if count < 2 {
        return (keys, values);
    }
    let blocks = count.div_ceil(BLOCK);
    let mut shift = 0;
    while shift < bits {
        // a pass reads and writes all pairs, whatever its digit: two nibbles at a time halve that
        let digit_bits = if bits - shift <= NIBBLE { NIBBLE } else { 2 * NIBBLE };
        let radix = 1 << digit_bits;
        let counts = empty_u32(&keys, [radix * blocks]);
        count_kernel::launch(
            &client,
            cubes(blocks),
            cube_dim(),
            buffer(&keys),
            buffer(&counts),
            count as u32,
            shift,
            radix,
        );
        let starts = starts(&counts);
        let sorted = [empty_u32(&keys, [count]), empty_u32(&keys, [count])];
        scatter_kernel::launch(
            &client,
            cubes(blocks),
            cube_dim(),
            buffer(&keys),
            buffer(&values),
            buffer(&starts),
            buffer(&sorted[0]),
            buffer(&sorted[1]),
            count as u32,
            shift,
            radix,
        );
        [keys, values] = sorted;
        shift += digit_bits;
    }
    (keys, values)
}
