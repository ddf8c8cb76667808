//! The backward pass. Pixels of a tile do not share an order, so that each goes back by itself, over the list of its fragments,
//! and writes what it says about them into a slot of every entry of the list of the tile. Sums over pixels are made from
//! these.

use burn::backend::TensorMetadata;
use burn_cubecl::CubeBackend;
use burn_cubecl::tensor::CubeTensor;
use cubecl::prelude::*;

use super::super::back::{backward, pixel_grad, spread_of};
use super::super::fold::{find_furthest, list_in_band};
use super::super::fragments::{FEATURES, Fragments, Payload, on_ellipse};
use super::super::{THROUGH, Thresholds};
use super::walk::{END, LAST, PIXEL_STATE, said_at, said_numbers, walk_rays};
use crate::camera::Camera;
use crate::footprint::gaussian::cube::Splat;
use crate::footprint::gaussian::cube::along_ray::ROW;
use crate::gpu::gather::zeros;
use crate::gpu::launch::{UNITS, buffer, cube_dim, cubes, empty_f32, empty_u32, largest_buffer};
use crate::gpu::record::Record;
use crate::gpu::tile::own_pixel;
use crate::gpu::view::CameraUniforms;
use crate::ops::blend::{BlendLists, BlendOptions};

/// Largest buffer for what the pixels of some tiles say, bytes.
const LARGEST: usize = 256 << 20;

/// Values of the pixels of the tiles of a band for their entries.
pub struct Said {
    /// [entries, [`said_numbers`], [`UNITS`]]; 0 where a pixel has no fragment
    pub numbers: CubeTensor,
    /// `[tiles]` place behind the last entry of each tile that any pixel has a fragment of
    pub ends: CubeTensor,
}

impl Said {
    /// Room for the entries of a band of tiles of the image.
    pub fn new(like: &CubeTensor, entries: usize, tiles: usize, maps: bool) -> Self {
        let numbers = empty_f32(like, [entries, said_numbers(maps), UNITS as usize]);
        Self { numbers, ends: empty_u32(like, [tiles]) }
    }

    /// Numbers about an entry.
    pub fn width(maps: bool) -> usize {
        said_numbers(maps) * UNITS as usize
    }

    /// How many entries a buffer has room for.
    pub fn most_entries(like: &CubeTensor, maps: bool) -> usize {
        largest_buffer(like).min(LARGEST) / (size_of::<f32>() * Self::width(maps))
    }
}

#[cube(launch)]
fn replay_kernel(
    table: &[f32],
    features: &[f32],
    offsets: &[u32],
    ids: &[u32],
    grad: &[f32],
    said: &mut [f32],
    said_ends: &mut [u32],
    view: CameraUniforms,
    thresholds: Thresholds,
    first_tile: u32,
    end_tile: u32,
    #[comptime] maps: bool,
) {
    let tile = first_tile + CUBE_POS as u32;
    if tile >= end_tile {
        terminate!();
    }
    let (list, slot) = list_in_band(offsets, tile, first_tile);
    let numbers = comptime!(said_numbers(maps));
    // pixels write into the slots of what they blended only, and a new buffer has any contents
    for position in 0..list.length {
        #[unroll]
        for number in 0..numbers {
            said[said_at(slot + position, numbers) + comptime!(number * UNITS as usize)] = 0.0f32;
        }
    }
    let mut state = zeros(PIXEL_STATE);
    walk_rays(&mut state, table, features, list, ids, said, slot, tile, view, thresholds, maps, true);

    let unit = UNIT_POS as usize;
    let mut ends = Shared::<[u32]>::new_slice(comptime!(UNITS as usize));
    ends[unit] = u32::cast_from(state[END]);
    find_furthest(&mut ends, UNITS);
    if unit == 0 {
        said_ends[tile as usize] = ends[0];
    }

    let own = own_pixel(view, tile);
    let of = pixel_grad(grad, own.at, view, maps);
    let spread = spread_of(&state);
    let mut through = state[THROUGH];
    let mut behind = -of.alpha;
    let mut last = state[LAST];
    // no barrier from here on, since pixels have blended different numbers of fragments
    while last >= 0.0f32 {
        let position = u32::cast_from(last);
        let at = said_at(slot + position, numbers);
        // the slot holds the position of the fragment before, until the backward pass overwrites it with what it says
        last = said[at];
        let i = list.entry(ids, position) as usize;
        let found = on_ellipse(Splat::load(table, i * ROW), own.x, own.y);
        let payload = Payload::load(features, i * FEATURES);
        let back = backward(found, payload, through, behind, &of, &spread, thresholds, maps);
        said[at] = back.power;
        said[at + comptime!(UNITS as usize)] = back.covered;
        if comptime!(maps) {
            said[at + comptime!(2 * UNITS as usize)] = back.grad_depth;
        }
        through = back.through;
        behind = back.behind;
    }
}

/// Goes back through the tiles of a band, with the gradient `grad` of the planes.
pub fn replay(
    fragments: &Fragments,
    lists: &BlendLists<CubeBackend>,
    grad: &CubeTensor,
    said: &Said,
    [first_tile, end_tile]: [u32; 2],
    camera: &Camera,
    options: &BlendOptions,
) {
    debug_assert!(said.ends.shape()[0] >= end_tile as usize);
    replay_kernel::launch(
        &grad.client.clone(),
        cubes((end_tile - first_tile) as usize),
        cube_dim(),
        buffer(fragments.by_rays()),
        buffer(&fragments.features),
        buffer(&lists.offsets),
        buffer(&lists.primitives),
        buffer(grad),
        buffer(&said.numbers),
        buffer(&said.ends),
        CameraUniforms::launch(camera),
        Thresholds::launch(camera, options),
        first_tile,
        end_tile,
        options.maps,
    );
}
