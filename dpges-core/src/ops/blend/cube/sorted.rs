//! Sums over the pixels of every primitive, where all pixels of a tile share the order of its list. One cube per tile goes back to
//! front from where the forward pass left each pixel; a division by 1 − α recovers T. A unit adds up several pixels by itself, so
//! that what it loads of a primitive serves all of them, and few units wait at the barriers.

use cubecl::prelude::*;

use super::back::{PixelGrad, Spread, backward, pixel_grad};
use super::fold::{Layout, Seen, add_pixel, find_furthest, list_in_band};
use super::fragments::{FEATURES, Payload, Shape};
use super::{FIRST_MOMENT, REFERENCE, SECOND_MOMENT, THROUGH, TOTAL, Thresholds};
use crate::gpu::gather::zeros;
use crate::gpu::launch::UNITS;
use crate::gpu::record::Record;
use crate::gpu::tile::{own_pixel, pixel_of, plane_of};
use crate::gpu::view::CameraUniforms;

/// Pixels of a unit, each of another region, and units of a cube.
const PIXELS: usize = 4;
pub const WORKERS: u32 = UNITS / PIXELS as u32;

/// Additions of an iteration. Mesa's lavapipe ends a kernel's loops after 65,535 iterations of all of them together, which one
/// for each addition would reach after a thousand entries.
const UNROLLED: u32 = 16;

/// Entries whose sums of `width` numbers are added up together.
// 24 numbers of every unit take 6 KiB of workgroup memory: more would leave few subgroups at once to a processor
fn entries_together(width: usize) -> usize {
    (24 / width).max(1)
}

/// Planes of where a pixel ends: position in the list before which it does, T there; with maps what distortion sums up.
const END: usize = 0;
const LEFT: usize = 1;
const SPREAD: usize = 2;

/// Planes of where pixels end.
pub fn end_planes(maps: bool) -> usize {
    if maps { SPREAD + 4 } else { SPREAD }
}

/// Writes where the pixel of this unit in `tile` ends, `end` in the list, with its `state`.
#[cube]
pub fn write_end(
    ends: &mut [f32],
    state: &Array<f32>,
    end: u32,
    view: CameraUniforms,
    tile: u32,
    #[comptime] maps: bool,
) {
    let own = own_pixel(view, tile);
    if own.inside {
        let plane = plane_of(view);
        // an f32 counts the 2²⁴ first entries of a tile, as in the order of rays
        ends[own.at + END * plane] = f32::cast_from(end);
        ends[own.at + LEFT * plane] = state[THROUGH];
        if comptime!(maps) {
            ends[own.at + SPREAD * plane] = state[REFERENCE];
            ends[own.at + (SPREAD + 1) * plane] = state[TOTAL];
            ends[own.at + (SPREAD + 2) * plane] = state[FIRST_MOMENT];
            ends[own.at + (SPREAD + 3) * plane] = state[SECOND_MOMENT];
        }
    }
}

/// The sums of a pixel behind its last fragment, as [`write_end`] left them.
#[cube]
fn spread_at(ends: &[f32], pixel: usize, plane: usize, #[comptime] maps: bool) -> Spread {
    let mut spread = Spread { reference: 0.0f32, total: 0.0f32, first_moment: 0.0f32, second_moment: 0.0f32 };
    if comptime!(maps) {
        spread.reference = ends[pixel + SPREAD * plane];
        spread.total = ends[pixel + (SPREAD + 1) * plane];
        spread.first_moment = ends[pixel + (SPREAD + 2) * plane];
        spread.second_moment = ends[pixel + (SPREAD + 3) * plane];
    }
    spread
}

/// Sums over the pixels of each tile of a band for the entries of its list. Cubes have [`WORKERS`] units, each of which adds up one
/// number of an entry: no layout may be wider.
#[cube(launch)]
pub fn gather_sorted_kernel(
    shapes: &[f32],
    features: &[f32],
    offsets: &[u32],
    ids: &[u32],
    grad: &[f32],
    ends: &[f32],
    sums: &mut [f32],
    view: CameraUniforms,
    thresholds: Thresholds,
    first_tile: u32,
    end_tile: u32,
    #[comptime] layout: Layout,
) {
    let tile = first_tile + CUBE_POS as u32;
    if tile >= end_tile {
        terminate!();
    }
    let width = comptime!(layout.width());
    let most = comptime!(entries_together(layout.width()) as u32);
    let (list, slot) = list_in_band(offsets, tile, first_tile);
    let unit = UNIT_POS as usize;
    let plane = plane_of(view);

    // only constants index these arrays, so that they stay in registers
    let mut x = Array::<f32>::new(PIXELS);
    let mut y = Array::<f32>::new(PIXELS);
    let mut end = Array::<u32>::new(PIXELS);
    let mut through = Array::<f32>::new(PIXELS);
    // derivative with respect to T behind the fragment that is next
    let mut behind = Array::<f32>::new(PIXELS);
    let mut of = Sequence::<PixelGrad>::new();
    let mut spread = Sequence::<Spread>::new();
    let mut last = 0u32.runtime();
    #[unroll]
    for own in 0..PIXELS {
        let place = pixel_of(view, tile, UNIT_POS + comptime!(own as u32 * WORKERS));
        x[own] = place.x;
        y[own] = place.y;
        end[own] = select(place.inside, u32::cast_from(ends[place.at + END * plane]), 0u32);
        through[own] = ends[place.at + LEFT * plane];
        let grads = pixel_grad(grad, place.at, view, layout.maps);
        behind[own] = -grads.alpha;
        of.push(grads);
        spread.push(spread_at(ends, place.at, plane, layout.maps));
        last = max(last, end[own]);
    }
    let mut lasts = Shared::<[u32]>::new_slice(comptime!(WORKERS as usize));
    lasts[unit] = last;
    find_furthest(&mut lasts, WORKERS);
    let furthest = workgroup_uniform_load(&lasts[0]);

    let mut partial =
        Shared::<[f32]>::new_slice(comptime!(WORKERS as usize * entries_together(layout.width()) * layout.width()));
    let rounds = furthest.div_ceil(most);
    for round in 0..rounds {
        let top = furthest - round * most;
        let entries = min(top, most);
        for entry in 0..entries {
            let position = top - 1u32 - entry;
            let i = list.entry(ids, position) as usize;
            let shape = Shape::load(shapes, features, i, layout.form);
            let payload = Payload::load(features, i * FEATURES);
            let mut own = zeros(width);
            #[unroll]
            for pixel in 0..PIXELS {
                if position < end[pixel] {
                    let found = shape.at(x[pixel], y[pixel], view);
                    if found.weight != 0.0f32 {
                        let back = backward(
                            found,
                            payload,
                            through[pixel],
                            behind[pixel],
                            &of[pixel],
                            &spread[pixel],
                            thresholds,
                            layout.maps,
                        );
                        through[pixel] = back.through;
                        behind[pixel] = back.behind;
                        let seen = Seen {
                            power: back.power,
                            covered: back.covered,
                            grad_depth: back.grad_depth,
                            by_plane: found.by_plane,
                        };
                        add_pixel(&mut own, shape, features, i, &of[pixel], x[pixel], y[pixel], seen, view, layout);
                    }
                }
            }
            #[unroll]
            for number in 0..width {
                partial[(entry as usize * width + number) * WORKERS as usize + unit] = own[number];
            }
        }
        sync_cube();
        if unit < entries as usize * width {
            let mut sum = 0.0f32;
            for part in 0..comptime!(WORKERS / UNROLLED) {
                #[unroll]
                for step in 0..UNROLLED {
                    // each unit begins at another bank of the memory
                    let of_unit = (part * UNROLLED + step + UNIT_POS) % WORKERS;
                    sum += partial[unit * WORKERS as usize + of_unit as usize];
                }
            }
            let position = top - 1u32 - (unit / width) as u32;
            sums[(slot + position) as usize * width + unit % width] = sum;
        }
        sync_cube();
    }
    // entries behind the ends of all pixels
    let mut at = furthest as usize * width + unit;
    while at < list.length as usize * width {
        sums[slot as usize * width + at] = 0.0f32;
        at += WORKERS as usize;
    }
}
