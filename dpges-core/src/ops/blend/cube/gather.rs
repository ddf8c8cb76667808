//! Sums over the pixels of every primitive. Every entry of the list of a tile has a slot for the
//! sums over the pixels of the tile, and slots are added in the order of the tiles. Where the slots of all tiles
//! exceed the largest buffer, some tiles are handled after the others. In the order of rays, whose pixels go back by
//! themselves, the slots are sums of what each says about each entry, and the tiles are handled as many at a time as there is
//! room for that.

use std::ops::Range;

use burn::backend::TensorMetadata;
use burn::tensor::TensorData;
use burn_cubecl::CubeBackend;
use burn_cubecl::tensor::CubeTensor;
use cubecl::prelude::*;

use super::fold::{ENTRIES, GROUP, Layout, NUMBERS, fold_entries, list_in_band};
use super::fragments::Fragments;
use super::hybrid::gather_mixed;
use super::rays::{Said, replay, said_at, said_numbers};
use super::sorted::{WORKERS, gather_sorted_kernel};
use super::{Thresholds, is_shared};
use crate::camera::Camera;
use crate::counters::transfers::{download, wait};
use crate::error::Error;
use crate::gpu::gather::{lane, primitive, total, zeros};
use crate::gpu::launch::{
    GATHERED, LANES, UNITS, buffer, cube_dim, cubes, empty_f32, empty_u32, gatherers, largest_buffer, units,
};
use crate::gpu::view::CameraUniforms;
use crate::ops::blend::{BlendLists, BlendOptions};
use crate::scene::{BlendOrder, Transparency};
use crate::tiles::TileGrid;
use crate::tiles::capacity::exceed;

/// Sums over the pixels of each tile of a band for the entries of its list, in the order of the core of each pixel.
#[cube(launch)]
fn gather_mixed_kernel(
    shapes: &[f32],
    features: &[f32],
    offsets: &[u32],
    ids: &[u32],
    grad: &[f32],
    sums: &mut [f32],
    view: CameraUniforms,
    thresholds: Thresholds,
    first_tile: u32,
    end_tile: u32,
    #[comptime] transparency: Transparency,
    #[comptime] layout: Layout,
) {
    let tile = first_tile + CUBE_POS as u32;
    if tile >= end_tile {
        terminate!();
    }
    let (list, slot) = list_in_band(offsets, tile, first_tile);
    gather_mixed(sums, shapes, features, list, slot, ids, grad, tile, view, thresholds, transparency, layout);
}

/// [`gather_mixed_kernel`] in the order of each pixel's own ray, of ellipsoids: what pixels say about the entries of a band of
/// tiles is known.
#[cube(launch)]
fn gather_said_kernel(
    shapes: &[f32],
    offsets: &[u32],
    ids: &[u32],
    grad: &[f32],
    said: &[f32],
    said_ends: &[u32],
    sums: &mut [f32],
    view: CameraUniforms,
    first_tile: u32,
    end_tile: u32,
    #[comptime] layout: Layout,
) {
    let tile = first_tile + CUBE_POS as u32;
    if tile >= end_tile {
        terminate!();
    }
    let width = comptime!(layout.width());
    let numbers = comptime!(said_numbers(layout.maps));
    let unit = UNIT_POS as usize;
    let (list, slot) = list_in_band(offsets, tile, first_tile);
    let mut last = Shared::<[u32]>::new_slice(1usize);
    if UNIT_POS == 0u32 {
        last[0] = said_ends[tile as usize];
    }
    let furthest = workgroup_uniform_load(&last[0]);
    let mut partial = Shared::<[f32]>::new_slice(comptime!(UNITS as usize * GROUP));
    let rounds = furthest.div_ceil(ENTRIES);
    for round in 0..rounds {
        let top = furthest - round * ENTRIES;
        for entry in 0..min(top, ENTRIES) {
            let from = said_at(slot + top - 1u32 - entry, numbers);
            let at = entry as usize * NUMBERS * UNITS as usize + unit;
            #[unroll]
            for number in 0..numbers {
                partial[at + number * UNITS as usize] = said[from + number * UNITS as usize];
            }
            if comptime!(!layout.maps) {
                partial[at + 2 * UNITS as usize] = 0.0f32;
            }
        }
        sync_cube();
        // ellipsoids have no features that sums need
        fold_entries(&mut partial, sums, shapes, shapes, ids, grad, list, top, slot, tile, view, layout);
    }
    let mut at = furthest as usize * width + unit;
    while at < list.length as usize * width {
        sums[slot as usize * width + at] = 0.0f32;
        at += UNITS as usize;
    }
}

/// The place of every pair among those sorted by tile.
#[cube(launch)]
fn places_kernel(pairs: &[u32], places: &mut [u32], count: u32) {
    if ABSOLUTE_POS >= count as usize {
        terminate!();
    }
    places[pairs[ABSOLUTE_POS] as usize] = ABSOLUTE_POS as u32;
}

/// Adds the slots of every primitive in the order of the tiles: `taken` sums from the `first` on. Rows are in the
/// order of the parameters.
#[cube(launch)]
fn collect_kernel(
    starts: &[u32],
    places: &[u32],
    offsets: &[u32],
    order: &[u32],
    slots: &[f32],
    sums: &mut [f32],
    first_tile: u32,
    end_tile: u32,
    count: u32,
    pairs: u32,
    #[comptime] first: usize,
    #[comptime] taken: usize,
    #[comptime] width: usize,
) {
    if CUBE_POS * GATHERED >= count as usize {
        terminate!();
    }
    let mut own = zeros(taken);
    let rank = primitive();
    if rank < count as usize {
        let (low, high) = (offsets[first_tile as usize], offsets[end_tile as usize]);
        // a list that had no room has fewer pairs than its primitives have
        let end = min(starts[rank + 1], pairs);
        let mut pair = starts[rank] + lane();
        while pair < end {
            let place = places[pair as usize];
            if place >= low && place < high {
                let slot = (place - low) as usize * width + first;
                #[unroll]
                for number in 0..taken {
                    own[number] += slots[slot + number];
                }
            }
            pair += LANES;
        }
    }
    let sum = total(&own, count, taken);
    if sum.present {
        // one cube adds all slots of a primitive, in a fixed order: the same bits in every run
        let at = order[sum.primitive] as usize * taken + sum.number;
        // a new buffer has any contents
        if first_tile == 0u32 {
            sums[at] = sum.value;
        } else {
            sums[at] += sum.value;
        }
    }
}

/// Ranges of tiles whose slots of `width` numbers fit a buffer: `most` of them. [Exceeds](exceed) the capacity if those of
/// one tile do not.
fn bands(offsets: &CubeTensor, pairs: usize, tiles: usize, most: usize, width: usize) -> Vec<Range<usize>> {
    // offsets are on the device: only where one buffer does not do, the host waits for them
    if pairs <= most {
        return std::iter::once(0..tiles).collect();
    }
    let bytes = wait(|| offsets.client.read_one(offsets.handle.clone())).expect("the device answers");
    let offsets: Vec<u32> = bytes.chunks_exact(size_of::<u32>()).map(bytemuck::pod_read_unaligned).collect();
    let offsets = download(TensorData::new(offsets, [tiles + 1]));
    let offsets: Vec<usize> = offsets.iter::<u32>().map(|offset| offset as usize).collect();
    let mut bands: Vec<Range<usize>> = Vec::new();
    for tile in 0..tiles {
        let length = offsets[tile + 1] - offsets[tile];
        if length > most {
            let what = format!("the gradients of the {length} primitives that touch one tile of this view");
            let [needed, largest] = [length, most].map(|slots| (slots * width * size_of::<f32>()) as u64);
            exceed(Error::Capacity { what, needed, largest });
        }
        match bands.last_mut() {
            Some(band) if offsets[tile + 1] - offsets[band.start] <= most => band.end = tile + 1,
            _ => bands.push(tile..tile + 1),
        }
    }
    bands
}

/// Sums of the shape [M, [`Layout::shape`]] and the rest [M, [`Layout::rest`]] for the gradient `grad` [P, H, W].
/// Rows are in the order of the parameters. `ends` says where pixels end that share the order of the list.
pub fn gather(
    fragments: &Fragments,
    lists: &BlendLists<CubeBackend>,
    ends: &CubeTensor,
    grad: &CubeTensor,
    camera: &Camera,
    options: &BlendOptions,
    layout: Layout,
) -> [CubeTensor; 2] {
    let (client, count, pairs) = (grad.client.clone(), lists.order.shape()[0], lists.pairs.shape()[0]);
    let (tiles, width) = (TileGrid::new(camera.width, camera.height).len(), layout.width());
    let places = empty_u32(grad, [pairs]);
    places_kernel::launch(&client, units(pairs), cube_dim(), buffer(&lists.pairs), buffer(&places), pairs as u32);
    let (most, per_entry) = match options.order {
        BlendOrder::Centres | BlendOrder::Whitened(_) => (largest_buffer(grad) / (size_of::<f32>() * width), width),
        BlendOrder::Rays => (Said::most_entries(grad, layout.maps), Said::width(layout.maps)),
    };
    let room = pairs.min(most);
    let slots = empty_f32(grad, [room, width]);
    let said = (options.order == BlendOrder::Rays).then(|| Said::new(grad, room, tiles, layout.maps));
    // in two launches: all sums of the primitives of a cube exceed its 16 KiB of workgroup memory
    let parts = [(0, layout.shape()), (layout.shape(), layout.rest())];
    let sums = parts.map(|(_, taken)| empty_f32(grad, [count, taken]));
    for band in bands(&lists.offsets, pairs, tiles, most, per_entry) {
        let [first_tile, end_tile] = [band.start, band.end].map(|tile| tile as u32);
        match &said {
            None if is_shared(options.order) => gather_sorted_kernel::launch(
                &client,
                cubes(band.len()),
                CubeDim::new_1d(WORKERS),
                buffer(&fragments.shapes),
                buffer(&fragments.features),
                buffer(&lists.offsets),
                buffer(&lists.primitives),
                buffer(grad),
                buffer(ends),
                buffer(&slots),
                CameraUniforms::launch(camera),
                Thresholds::launch(camera, options),
                first_tile,
                end_tile,
                layout,
            ),
            None => gather_mixed_kernel::launch(
                &client,
                cubes(band.len()),
                cube_dim(),
                buffer(&fragments.shapes),
                buffer(&fragments.features),
                buffer(&lists.offsets),
                buffer(&lists.primitives),
                buffer(grad),
                buffer(&slots),
                CameraUniforms::launch(camera),
                Thresholds::launch(camera, options),
                first_tile,
                end_tile,
                options.order.transparency().unwrap_or(Transparency::Sorted),
                layout,
            ),
            Some(said) => {
                replay(fragments, lists, grad, said, [first_tile, end_tile], camera, options);
                gather_said_kernel::launch(
                    &client,
                    cubes(band.len()),
                    cube_dim(),
                    buffer(&fragments.shapes),
                    buffer(&lists.offsets),
                    buffer(&lists.primitives),
                    buffer(grad),
                    buffer(&said.numbers),
                    buffer(&said.ends),
                    buffer(&slots),
                    CameraUniforms::launch(camera),
                    first_tile,
                    end_tile,
                    layout,
                );
            }
        }
        for ((first, taken), sums) in parts.into_iter().zip(&sums) {
            collect_kernel::launch(
                &client,
                gatherers(count),
                cube_dim(),
                buffer(&lists.starts),
                buffer(&places),
                buffer(&lists.offsets),
                buffer(&lists.order),
                buffer(&slots),
                buffer(sums),
                first_tile,
                end_tile,
                count as u32,
                pairs as u32,
                first,
                taken,
                width,
            );
        }
    }
    sums
}
