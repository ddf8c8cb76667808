//! The walk through a tile, each pixel in its own order. The CPU's twin is `cpu::rays`.
//!
//! The list of the tile comes in batches. All units of the cube ask which entries of a batch reach which blocks, and how far
//! along the rays of these. One unit for each block then runs its queue, and what leaves it replaces the batch. Every pixel
//! runs the queue of its quad for itself, and its own: both fit into registers.

use cubecl::prelude::*;

use super::super::fragments::{FEATURES, Fragment, Payload, on_ellipse};
use super::super::order::{NO_KEY, sort_key};
use super::super::{STATE, THROUGH, Thresholds, add_fragment};
use crate::footprint::gaussian::cube::along_ray::{AlongRay, ROW, unit_ray};
use crate::footprint::gaussian::cube::{SPLAT, Splat};
use crate::gpu::launch::{LANES, UNITS};
use crate::gpu::record::Record;
use crate::gpu::tile::{REGION_COLUMNS, REGION_HEIGHT, REGION_WIDTH, REGIONS, TILE, own_pixel};
use crate::gpu::vector::Vec3;
use crate::gpu::view::CameraUniforms;
use crate::ops::blend::QUEUES;
use crate::tiles::binning::cube::TileList;

/// Edges of a block and of a quad, px.
const BLOCK: u32 = 4;
const QUAD: u32 = 2;
const HALF_BLOCK: u32 = BLOCK / 2;
const HALF_QUAD: u32 = QUAD / 2;
const _: () = assert!(BLOCK == REGION_HEIGHT, "blocks stand side by side in a region");
/// Blocks in a region and in a tile.
const ACROSS: u32 = REGION_WIDTH / BLOCK;
const BLOCKS: usize = REGIONS * ACROSS as usize;
/// Most entries of the queues.
const BLOCK_QUEUE: u32 = QUEUES[0] as u32;
const QUAD_QUEUE: usize = QUEUES[1];
const PIXEL_QUEUE: usize = QUEUES[2];
/// Entries of a batch.
const BATCH: u32 = 64;
const _: () = assert!(BLOCK_QUEUE <= BATCH, "there is room for what leaves a block at last");
/// Position of nothing.
const NOTHING: u32 = NO_KEY;

/// State of a pixel besides its sums, by place in its array: as numbers, the position of the fragment that was blended
/// last, −1 before the first, and the position behind the largest.
pub const LAST: usize = STATE;
pub const END: usize = STATE + 1;
pub const PIXEL_STATE: usize = STATE + 2;

/// Column and row of a block in its tile, px.
#[cube]
fn block_corner(block: u32) -> (u32, u32) {
    let region = block / ACROSS;
    let column = region % REGION_COLUMNS * REGION_WIDTH + block % ACROSS * BLOCK;
    (column, region / REGION_COLUMNS * REGION_HEIGHT)
}

/// Place of what a pixel says about the entry at `position` of the lists of a band.
#[cube]
pub fn said_at(position: u32, #[comptime] numbers: usize) -> usize {
    position as usize * comptime!(numbers * UNITS as usize) + UNIT_POS as usize
}

/// Numbers that a pixel says about an entry: gradient of the exponent, αT and, with maps, gradient of the depth.
pub fn said_numbers(maps: bool) -> usize {
    if maps { 3 } else { 2 }
}

/// Writes down that the entry at a `position` of the list was blended, if it was.
#[cube]
fn record_last(
    state: &mut Array<f32>,
    said: &mut [f32],
    slot: u32,
    position: u32,
    was_blended: bool,
    #[comptime] maps: bool,
) {
    if was_blended {
        said[said_at(slot + position, comptime!(said_numbers(maps)))] = state[LAST];
        state[LAST] = f32::cast_from(position);
        state[END] = max(state[END], f32::cast_from(position + 1u32));
    }
}

/// Blends the tile into `state` [[`PIXEL_STATE`]], zero so far, of the pixel of each unit. If it `records`, every fragment
/// that is blended gets the position of the one before it, by the place of the list in its band, `slot`: see [`said_at`].
/// All units of the cube must call this together.
#[cube]
pub fn walk_rays(
    state: &mut Array<f32>,
    table: &[f32],
    features: &[f32],
    list: TileList,
    ids: &[u32],
    said: &mut [f32],
    slot: u32,
    tile: u32,
    view: CameraUniforms,
    thresholds: Thresholds,
    #[comptime] maps: bool,
    #[comptime] records: bool,
) {
    let mut keys = Shared::<[u32]>::new_slice(comptime!(BLOCKS * BLOCK_QUEUE as usize));
    let mut waiting = Shared::<[u32]>::new_slice(comptime!(BLOCKS * BLOCK_QUEUE as usize));
    // keys of the entries of a batch, then positions of those that leave
    let mut stream = Shared::<[u32]>::new_slice(comptime!(BLOCKS * BATCH as usize));
    let mut counts = Shared::<[u32]>::new_slice(BLOCKS);
    let is_open = Shared::<[Atomic<u32>]>::new_slice(BLOCKS);
    let mut rays = Shared::<[f32]>::new_slice(comptime!(BLOCKS * 3));
    let unit = UNIT_POS as usize;
    let own = own_pixel(view, tile);
    let (left, top) = (tile % view.columns * TILE, tile / view.columns * TILE);
    let (region, lane) = (UNIT_POS / LANES, UNIT_POS % LANES);
    let block = region * ACROSS + lane % REGION_WIDTH / BLOCK;
    if unit < BLOCKS {
        let (column, row) = block_corner(UNIT_POS);
        let middle_x = f32::cast_from(left + column + HALF_BLOCK);
        let middle_y = f32::cast_from(top + row + HALF_BLOCK);
        Vec3::store(unit_ray(view, middle_x, middle_y), &mut rays, unit * 3);
        is_open[unit].store(1u32);
    }
    let column = region % REGION_COLUMNS * REGION_WIDTH + lane % REGION_WIDTH;
    let row = region / REGION_COLUMNS * REGION_HEIGHT + lane / REGION_WIDTH;
    let quad_x = f32::cast_from(left + column / QUAD * QUAD + HALF_QUAD);
    let quad_y = f32::cast_from(top + row / QUAD * QUAD + HALF_QUAD);
    let quad_ray = unit_ray(view, quad_x, quad_y);
    let pixel_ray = unit_ray(view, own.x, own.y);

    state[THROUGH] = 1.0f32;
    state[LAST] = -1.0f32;
    let mut open = own.inside;
    // the queue of the block of this unit: a ring
    let mut head = 0u32;
    let mut queued = 0u32;
    let mut quad_keys = Array::<u32>::new(QUAD_QUEUE);
    let mut quad_positions = Array::<u32>::new(QUAD_QUEUE);
    #[unroll]
    for place in 0..QUAD_QUEUE {
        quad_keys[place] = NO_KEY;
        quad_positions[place] = NOTHING;
    }
    let mut in_quad = 0u32;
    let mut pixel_keys = Array::<u32>::new(PIXEL_QUEUE);
    let mut pixel_positions = Array::<u32>::new(PIXEL_QUEUE);
    let mut pixel_weights = Array::<f32>::new(PIXEL_QUEUE);
    #[unroll]
    for place in 0..PIXEL_QUEUE {
        pixel_keys[place] = NO_KEY;
        pixel_positions[place] = NOTHING;
        pixel_weights[place] = 0.0f32;
    }
    let mut in_pixel = 0u32;

    // in the round after the last batch all queues are emptied
    let batches = list.length.div_ceil(BATCH);
    for round in 0..batches + 1u32 {
        let first = round * BATCH;
        let entries = min(BATCH, list.length - min(list.length, first));
        sync_cube();
        for step in 0..comptime!(BLOCKS as u32 * BATCH / UNITS) {
            let task = step * UNITS + UNIT_POS;
            let (of, entry) = (task % BLOCKS as u32, task / BLOCKS as u32);
            let mut key = u32::cast_from(NO_KEY);
            if entry < entries && is_open[of as usize].load() > 0u32 {
                let i = list.entry(ids, first + entry) as usize * ROW;
                let (column, row) = block_corner(of);
                if Splat::load(table, i).reaches(left + column, top + row, BLOCK, BLOCK) {
                    let ray = Vec3::load(&rays, of as usize * 3);
                    key = sort_key(AlongRay::load(table, i + SPLAT).depth(ray));
                }
            }
            stream[(of * BATCH + entry) as usize] = key;
        }
        sync_cube();
        if unit < BLOCKS {
            let (ring, batch) = (UNIT_POS * BLOCK_QUEUE, UNIT_POS * BATCH);
            let mut leaving = 0u32;
            if is_open[unit].load() > 0u32 {
                for entry in 0..entries {
                    let key = stream[(batch + entry) as usize];
                    if key != NO_KEY {
                        if queued == BLOCK_QUEUE {
                            // no more have left than were looked at
                            stream[(batch + leaving) as usize] = waiting[(ring + head) as usize];
                            leaving += 1u32;
                            head = (head + 1u32) % BLOCK_QUEUE;
                            queued -= 1u32;
                        }
                        let mut at = queued;
                        let mut moves = at > 0u32;
                        while moves {
                            let before = (ring + (head + at - 1u32) % BLOCK_QUEUE) as usize;
                            // `>` and not `>=`: equal keys leave in the order in which they came
                            moves = keys[before] > key;
                            if moves {
                                let behind = (ring + (head + at) % BLOCK_QUEUE) as usize;
                                keys[behind] = keys[before];
                                waiting[behind] = waiting[before];
                                at -= 1u32;
                                moves = at > 0u32;
                            }
                        }
                        let place = (ring + (head + at) % BLOCK_QUEUE) as usize;
                        keys[place] = key;
                        waiting[place] = first + entry;
                        queued += 1u32;
                    }
                }
                if round == batches {
                    for entry in 0..queued {
                        stream[(batch + entry) as usize] = waiting[(ring + (head + entry) % BLOCK_QUEUE) as usize];
                    }
                    leaving = queued;
                }
            }
            counts[unit] = leaving;
            // open pixels set it again at the end of the round, so that ended blocks take nothing more
            is_open[unit].store(0u32);
        }
        sync_cube();
        let leaving = counts[block as usize];
        // every queue after a block delays what enters it by as many places as it has
        let emptied = leaving + select(round == batches, comptime!((QUAD_QUEUE + PIXEL_QUEUE) as u32), 0u32);
        let mut step = 0u32;
        while step < emptied && open {
            // from the block into the quad, and out of the quad
            let mut position = u32::cast_from(NOTHING);
            let comes = step < leaving;
            if in_quad > 0u32 && (!comes || in_quad == comptime!(QUAD_QUEUE as u32)) {
                position = quad_positions[0];
                #[unroll]
                for place in 0..comptime!(QUAD_QUEUE - 1) {
                    quad_keys[place] = quad_keys[place + 1];
                    quad_positions[place] = quad_positions[place + 1];
                }
                quad_keys[comptime!(QUAD_QUEUE - 1)] = NO_KEY;
                in_quad -= 1u32;
            }
            if comes {
                let mut coming = stream[(block * BATCH + step) as usize];
                let i = list.entry(ids, coming) as usize * ROW;
                let mut key = sort_key(AlongRay::load(table, i + SPLAT).depth(quad_ray));
                let mut moves = false;
                #[unroll]
                for place in 0..QUAD_QUEUE {
                    // `<` and not `<=`: equal keys leave in the order in which they came
                    moves = moves || key < quad_keys[place];
                    let (other_key, other) = (quad_keys[place], quad_positions[place]);
                    quad_keys[place] = select(moves, key, other_key);
                    quad_positions[place] = select(moves, coming, other);
                    key = select(moves, other_key, key);
                    coming = select(moves, other, coming);
                }
                in_quad += 1u32;
            }
            // the fragment of what left the quad
            let mut weight = 0.0f32;
            let mut depth = 0.0f32;
            if position != NOTHING {
                let i = list.entry(ids, position) as usize * ROW;
                depth = AlongRay::load(table, i + SPLAT).depth(pixel_ray);
                let found = on_ellipse(Splat::load(table, i), own.x, own.y);
                weight = select(depth >= 0.0f32, found.weight, 0.0f32);
            }
            // out of the pixel, and into it
            let comes = weight > 0.0f32;
            let last = step >= leaving + comptime!(QUAD_QUEUE as u32);
            if in_pixel > 0u32 && (last || (comes && in_pixel == comptime!(PIXEL_QUEUE as u32))) {
                let out = pixel_positions[0];
                let i = list.entry(ids, out) as usize;
                let centre_depth = Payload::load(features, i * FEATURES).depth;
                let found = Fragment { weight: pixel_weights[0], depth: centre_depth, by_plane: 1.0f32 };
                open = add_fragment(state, found, features, i, thresholds, maps);
                if comptime!(records) {
                    record_last(state, said, slot, out, open, maps);
                }
                #[unroll]
                for place in 0..comptime!(PIXEL_QUEUE - 1) {
                    pixel_keys[place] = pixel_keys[place + 1];
                    pixel_positions[place] = pixel_positions[place + 1];
                    pixel_weights[place] = pixel_weights[place + 1];
                }
                pixel_keys[comptime!(PIXEL_QUEUE - 1)] = NO_KEY;
                in_pixel -= 1u32;
            }
            if comes {
                let mut key = sort_key(depth);
                let mut moves = false;
                #[unroll]
                for place in 0..PIXEL_QUEUE {
                    moves = moves || key < pixel_keys[place];
                    let (other_key, other) = (pixel_keys[place], pixel_positions[place]);
                    let other_weight = pixel_weights[place];
                    pixel_keys[place] = select(moves, key, other_key);
                    pixel_positions[place] = select(moves, position, other);
                    pixel_weights[place] = select(moves, weight, other_weight);
                    key = select(moves, other_key, key);
                    position = select(moves, other, position);
                    weight = select(moves, other_weight, weight);
                }
                in_pixel += 1u32;
            }
            step += 1u32;
        }
        if open {
            is_open[block as usize].store(1u32);
        }
    }
}
