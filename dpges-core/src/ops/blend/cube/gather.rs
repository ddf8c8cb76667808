//! Sums over the pixels of every primitive. One cube per tile goes front to back like the forward pass, then
//! back to front, where a division by 1 − α recovers T. Every entry of the list of a tile has a slot for the
//! sums over the pixels of the tile, and slots are added in the order of the tiles. Where the slots of all tiles
//! exceed the largest buffer, some tiles are handled after the others.

use std::ops::Range;

use burn::backend::TensorMetadata;
use burn::tensor::TensorData;
use burn_cubecl::CubeBackend;
use burn_cubecl::tensor::CubeTensor;
use cubecl::prelude::*;

use super::fragments::{FEATURES, Fragments, LOW_PASS, LowPass, Payload, TANGENTS, Tangents, fragment, on_ellipse};
use super::{FIRST_MOMENT, REFERENCE, SECOND_MOMENT, STATE, THROUGH, TOTAL, Thresholds, add_fragment};
use crate::camera::Camera;
use crate::counters::transfers::{download, wait};
use crate::error::Error;
use crate::footprint::gaussian::cube::regions::{WORDS, list_regions, mark_regions};
use crate::footprint::gaussian::cube::{SPLAT, Splat, add_moments};
use crate::footprint::moments::MOMENTS;
use crate::footprint::surfel::cube::{DISC_SUMS, DiscPixel, Hit, PLANE, Plane, add_disc_sums};
use crate::gpu::gather::{lane, primitive, total, zeros};
use crate::gpu::launch::{
    GATHERED, HALVINGS, LANES, UNITS, buffer, cube_dim, cubes, empty_f32, empty_u32, gatherers, largest_buffer, units,
};
use crate::gpu::record::Record;
use crate::gpu::tile::{Pixel, REGIONS, own_pixel, pixel_of, plane_of};
use crate::gpu::view::CameraUniforms;
use crate::ops::blend::{BlendLists, BlendOptions, Form};
use crate::tiles::TileGrid;
use crate::tiles::binning::cube::TileList;
use crate::tiles::capacity::exceed;

/// Entries whose sums a cube makes together, and the units that sum over the pixels of each.
const ENTRIES: u32 = 4;
const SHARE: u32 = UNITS / ENTRIES;
/// Numbers of an entry at a pixel: gradient of the exponent, covered share, gradient of the depth.
const NUMBERS: usize = 3;
/// Units that one unit folds for, and parts of a sum of an entry after that.
const FOLD: usize = 16;
const PARTS: usize = SHARE as usize / FOLD;
/// Sums of the probe: Σ x, Σ y, Σ |x|, Σ |y|.
pub const PROBE: usize = 4;
/// Sums that a cube folds at a time.
const GROUP: usize = 12;
const _: () = assert!(ENTRIES as usize * NUMBERS <= GROUP, "the memory to fold in holds what a pixel says");

/// The sums of a primitive, in this order: those of the shape ([`MOMENTS`] or [`DISC_SUMS`]), then the rest:
/// of the colour, of gradients that the shape lacks, of the normal, of the probe.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Layout {
    pub form: Form,
    pub maps: bool,
    pub probe: bool,
}

impl Layout {
    pub fn shape(self) -> usize {
        match self.form {
            Form::Ellipsoids => MOMENTS,
            Form::Discs => DISC_SUMS,
        }
    }

    /// Place among the rest of the gradients that the shape lacks: the depth of ellipsoids; the two coordinates
    /// of the low-pass filter and the exponent of discs.
    pub fn beside(self) -> usize {
        3
    }

    pub fn normal(self) -> usize {
        self.beside()
            + match self.form {
                Form::Ellipsoids => 1,
                Form::Discs => 3,
            }
    }

    pub fn probe(self) -> usize {
        self.normal() + if self.maps { 3 } else { 0 }
    }

    pub fn rest(self) -> usize {
        self.probe() + if self.probe { PROBE } else { 0 }
    }

    pub fn width(self) -> usize {
        self.shape() + self.rest()
    }
}

/// A primitive as a pixel sees it.
#[derive(CubeType, Clone, Copy)]
#[expand(derive(Clone, Copy))]
struct Seen {
    /// Gradient of the exponent.
    power: f32,
    /// αT
    covered: f32,
    grad_depth: f32,
    /// For a disc: 1 where its plane and not its low-pass decides, else 0.
    by_plane: f32,
}

/// Adds a pixel to the sums of primitive `i`, in the order of `layout`.
#[cube]
fn add_pixel(
    own: &mut Array<f32>,
    shapes: &[f32],
    features: &[f32],
    i: usize,
    grad: &[f32],
    place: Pixel,
    seen: Seen,
    view: CameraUniforms,
    #[comptime] layout: Layout,
) {
    let rest = comptime!(layout.shape());
    let beside = comptime!(layout.shape() + layout.beside());
    let normal = comptime!(layout.shape() + layout.normal());
    let probe = comptime!(layout.shape() + layout.probe());
    let (x, y, pixel, plane) = (place.x, place.y, place.at, plane_of(view));
    let (power, covered) = (seen.power, seen.covered);
    let (grad_depth, by_plane) = (seen.grad_depth, seen.by_plane);
    own[rest] += covered * grad[pixel];
    own[rest + 1] += covered * grad[pixel + plane];
    own[rest + 2] += covered * grad[pixel + 2 * plane];
    if comptime!(layout.maps) {
        own[normal] += covered * grad[pixel + 5 * plane];
        own[normal + 1] += covered * grad[pixel + 6 * plane];
        own[normal + 2] += covered * grad[pixel + 7 * plane];
    }
    let mut towards_x = 0.0f32;
    let mut towards_y = 0.0f32;
    if comptime!(layout.form == Form::Ellipsoids) {
        let splat = Splat::load(shapes, i * SPLAT);
        let (dx, dy) = (x - splat.mean_x, y - splat.mean_y);
        let (u, v) = (splat.u(dx, dy), splat.r * dy);
        add_moments(own, power, u, v);
        own[beside] += grad_depth;
        towards_x = power * splat.p * u;
        towards_y = power * (splat.q * u + splat.r * v);
    } else {
        let disc = Plane::load(shapes, i * PLANE);
        let low_pass = LowPass::load(features, i * FEATURES + LOW_PASS);
        let tangents = Tangents::load(features, i * FEATURES + TANGENTS);
        let met = disc.hit(x, y);
        let (dx, dy) = (x - disc.anchor_x, y - disc.anchor_y);
        // far from the disc they may be infinite
        let on_disc = by_plane > 0.5f32;
        let hit = Hit {
            u: select(on_disc, met.u, 0.0f32),
            v: select(on_disc, met.v, 0.0f32),
            depth: met.depth,
            facing: met.facing,
            kernel: met.kernel,
        };
        let on_way = DiscPixel {
            hit,
            across: dx / view.fx,
            down: dy / view.fy,
            scale_u: tangents.scale_u,
            scale_v: tangents.scale_v,
            power,
            grad_depth,
        };
        let towards = add_disc_sums(own, on_way, true, layout.maps);
        let on_screen = 2.0f32 * power * (1.0f32 - by_plane);
        own[beside] += on_screen * (dx - low_pass.offset_x);
        own[beside + 1] += on_screen * (dy - low_pass.offset_y);
        own[beside + 2] += power;
        if comptime!(layout.probe) {
            // gradient of the centre in camera space, over fx and fy: that of T_u.z and T_v.z
            let (ray_x, ray_y) = ((x - view.cx) / view.fx, (y - view.cy) / view.fy);
            let (u, v) = (tangents.u, tangents.v);
            let centre_x =
                towards.x * (ray_y * v.z - v.y) + towards.y * (u.y - u.z * ray_y) + towards.z * (u.y * v.z - u.z * v.y);
            let centre_y =
                towards.x * (v.x - ray_x * v.z) + towards.y * (u.z * ray_x - u.x) + towards.z * (u.z * v.x - u.x * v.z);
            let share = by_plane * Payload::load(features, i * FEATURES).depth;
            towards_x = share * centre_x / view.fx;
            towards_y = share * centre_y / view.fy;
        }
    }
    if comptime!(layout.probe) {
        let ndc_x = towards_x * f32::cast_from(view.width) * 0.5f32;
        let ndc_y = towards_y * f32::cast_from(view.height) * 0.5f32;
        own[probe] += ndc_x;
        own[probe + 1] += ndc_y;
        own[probe + 2] += f32::abs(ndc_x);
        own[probe + 3] += f32::abs(ndc_y);
    }
}

#[cube(launch)]
fn gather_kernel(
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
    #[comptime] layout: Layout,
) {
    let tile = first_tile + CUBE_POS as u32;
    if tile >= end_tile {
        terminate!();
    }
    let form = comptime!(layout.form);
    let width = comptime!(layout.width());
    let groups = comptime!(layout.width().div_ceil(GROUP));
    let unit = UNIT_POS as usize;
    let plane = plane_of(view);

    // the list of the tile, and the place of the first slot
    let mut range = Shared::<[u32]>::new_slice(3usize);
    if UNIT_POS == 0u32 {
        range[0] = offsets[tile as usize];
        range[1] = offsets[(tile + 1u32) as usize];
        range[2] = offsets[first_tile as usize];
    }
    let start = workgroup_uniform_load(&range[0]);
    let length = workgroup_uniform_load(&range[1]) - start;
    let slot = start - workgroup_uniform_load(&range[2]);

    let mut partial = Shared::<[f32]>::new_slice(comptime!(UNITS as usize * GROUP));
    let mut folded = Shared::<[f32]>::new_slice(comptime!(UNITS as usize / FOLD * GROUP));
    let mut ends = Shared::<[u32]>::new_slice(comptime!(UNITS as usize));
    let mut own = Array::<f32>::new(width);

    let place = own_pixel(view, tile);
    let (x, y, pixel) = (place.x, place.y, place.at);

    // front to back: T behind the last fragment, where the pixel ends, what distortion needs
    let mut state = zeros(STATE);
    state[THROUGH] = 1.0f32;
    let mut end = select(place.inside, length, 0u32);
    if comptime!(form == Form::Ellipsoids) {
        let list = TileList { start, length };
        let mut visits = Shared::<[u32]>::new_slice(comptime!(REGIONS * WORDS));
        let mut depths = Shared::<[f32]>::new_slice(REGIONS);
        if unit < REGIONS {
            depths[unit] = view.infinity;
        }
        let mut open = place.inside;
        let batches = list.batches();
        for batch in 0..batches {
            let entries = list.stage(ids, batch, shapes, shapes, &mut partial, (SPLAT, 0));
            mark_regions(&partial, entries, &depths, &mut ends, tile, view, SPLAT);
            list_regions(&ends, &mut visits);
            for word in 0..WORDS {
                let mut bits = visits[(UNIT_POS / LANES) as usize * WORDS + word];
                while bits != 0u32 && open {
                    let entry = word as u32 * 32u32 + bits.trailing_zeros();
                    bits &= bits - 1u32;
                    let found = on_ellipse(Splat::load(&partial, entry as usize * SPLAT), x, y);
                    if found.weight > 0.0f32 {
                        let position = batch * UNITS + entry;
                        let i = list.entry(ids, position) as usize;
                        open = add_fragment(&mut state, found, features, i, thresholds, layout.maps);
                        end = select(open, end, position);
                    }
                }
            }
        }
        sync_cube();
    } else {
        let mut position = 0u32;
        while position < end {
            let i = ids[(start + position) as usize] as usize;
            let found = fragment(shapes, features, i, x, y, view.near, form);
            if found.weight > 0.0f32 {
                let goes_on = add_fragment(&mut state, found, features, i, thresholds, layout.maps);
                end = select(goes_on, end, position);
            }
            position += 1u32;
        }
    }
    let mut through = state[THROUGH];
    let (reference, total) = (state[REFERENCE], state[TOTAL]);
    let (first_moment, second_moment) = (state[FIRST_MOMENT], state[SECOND_MOMENT]);

    ends[unit] = end;
    #[unroll]
    for halving in 0..HALVINGS {
        let step = comptime!((UNITS >> (halving + 1)) as usize);
        sync_cube();
        if unit < step {
            ends[unit] = max(ends[unit], ends[unit + step]);
        }
    }
    let furthest = workgroup_uniform_load(&ends[0]);

    let red = grad[pixel];
    let green = grad[pixel + plane];
    let blue = grad[pixel + 2 * plane];
    let mut of_depth = 0.0f32;
    let mut of_x = 0.0f32;
    let mut of_y = 0.0f32;
    let mut of_z = 0.0f32;
    let mut of_distortion = 0.0f32;
    if comptime!(layout.maps) {
        of_depth = grad[pixel + 4 * plane];
        of_x = grad[pixel + 5 * plane];
        of_y = grad[pixel + 6 * plane];
        of_z = grad[pixel + 7 * plane];
        of_distortion = grad[pixel + 8 * plane];
    }

    // back to front; derivative with respect to T behind the fragment that is next
    let of_alpha = grad[pixel + 3 * plane];
    let mut behind = -of_alpha;
    let rounds = furthest.div_ceil(ENTRIES);
    for round in 0..rounds {
        let top = furthest - round * ENTRIES;
        let entries = min(top, ENTRIES);
        // what every pixel says about the entries
        for entry in 0..ENTRIES {
            let mut power = 0.0f32;
            let mut covered = 0.0f32;
            let mut grad_depth = 0.0f32;
            let mut by_plane = 1.0f32;
            // beyond the first entry of the list this is large
            let position = top - 1u32 - entry;
            if entry < entries && position < end {
                let i = ids[(start + position) as usize] as usize;
                let found = fragment(shapes, features, i, x, y, view.near, form);
                if found.weight > 0.0f32 {
                    let payload = Payload::load(features, i * FEATURES);
                    let alpha = min(found.weight, thresholds.max_alpha);
                    let before = through / (1.0f32 - alpha);
                    covered = alpha * before;
                    by_plane = found.by_plane;
                    let colour = payload.colour;
                    let mut value = colour.x * red + colour.y * green + colour.z * blue;
                    if comptime!(layout.maps) {
                        let inverse = 1.0f32 / found.depth;
                        let mapped = thresholds.slope * (reference - inverse);
                        let spread = mapped * mapped * total + second_moment - 2.0f32 * mapped * first_moment;
                        let of_mapped = of_distortion * 2.0f32 * (mapped * total - first_moment);
                        value += of_depth * found.depth + of_distortion * spread;
                        value += payload.normal.x * of_x;
                        value += payload.normal.y * of_y;
                        value += payload.normal.z * of_z;
                        grad_depth = covered * (of_depth + of_mapped * thresholds.slope * inverse * inverse);
                    }
                    // a capped α has no gradient
                    power = select(found.weight < thresholds.max_alpha, covered * (value - behind), 0.0f32);
                    behind = alpha * value + (1.0f32 - alpha) * behind;
                    through = before;
                }
            }
            let at = entry as usize * NUMBERS * UNITS as usize + unit;
            partial[at] = power;
            // below 0 where the low-pass filter of a disc decides
            partial[at + UNITS as usize] = select(by_plane > 0.5f32, covered, -covered);
            partial[at + 2 * UNITS as usize] = grad_depth;
        }
        sync_cube();

        // some units sum over the pixels of each entry
        let (entry, member) = (UNIT_POS / SHARE, UNIT_POS % SHARE);
        #[unroll]
        for s in 0..width {
            own[s] = 0.0f32;
        }
        if entry < entries {
            let i = ids[(start + top - 1u32 - entry) as usize] as usize;
            for step in 0..ENTRIES {
                let other = step * SHARE + member;
                let at = entry as usize * NUMBERS * UNITS as usize + other as usize;
                let signed = partial[at + UNITS as usize];
                if signed != 0.0f32 {
                    let covered = f32::abs(signed);
                    let seen = Seen {
                        power: partial[at],
                        covered,
                        grad_depth: partial[at + 2 * UNITS as usize],
                        by_plane: select(signed > 0.0f32, 1.0f32, 0.0f32),
                    };
                    add_pixel(&mut own, shapes, features, i, grad, pixel_of(view, tile, other), seen, view, layout);
                }
            }
        }
        sync_cube();

        #[unroll]
        for group in 0..groups {
            #[unroll]
            for s in 0..GROUP {
                if comptime!(group * GROUP + s < width) {
                    partial[s * UNITS as usize + unit] = own[group * GROUP + s];
                }
            }
            sync_cube();
            // several units fold each sum, then one unit
            if unit < UNITS as usize / FOLD * GROUP {
                let mut part = 0.0f32;
                for k in 0..FOLD {
                    part += partial[unit * FOLD + k];
                }
                folded[unit] = part;
            }
            sync_cube();
            let number = unit / ENTRIES as usize;
            let of_entry = UNIT_POS % ENTRIES;
            if number < GROUP && comptime!(group * GROUP) + number < width && of_entry < entries {
                let mut sum = 0.0f32;
                for k in 0..PARTS {
                    sum += folded[number * (UNITS as usize / FOLD) + of_entry as usize * PARTS + k];
                }
                let target = (slot + top - 1u32 - of_entry) as usize * width;
                sums[target + comptime!(group * GROUP) + number] = sum;
            }
        }
    }
    // entries behind the ends of all pixels
    let mut at = furthest as usize * width + unit;
    while at < length as usize * width {
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
        let at = order[sum.primitive] as usize * taken + sum.number;
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
/// Rows are in the order of the parameters.
pub fn gather(
    fragments: &Fragments,
    lists: &BlendLists<CubeBackend>,
    grad: &CubeTensor,
    camera: &Camera,
    options: &BlendOptions,
    layout: Layout,
) -> [CubeTensor; 2] {
    let (client, count, pairs) = (grad.client.clone(), lists.order.shape()[0], lists.pairs.shape()[0]);
    let (tiles, width) = (TileGrid::new(camera.width, camera.height).len(), layout.width());
    let places = empty_u32(grad, [pairs]);
    places_kernel::launch(&client, units(pairs), cube_dim(), buffer(&lists.pairs), buffer(&places), pairs as u32);
    let most = largest_buffer(grad) / (size_of::<f32>() * width);
    let slots = empty_f32(grad, [pairs.min(most), width]);
    let parts = [(0, layout.shape()), (layout.shape(), layout.rest())];
    let sums = parts.map(|(_, taken)| empty_f32(grad, [count, taken]));
    for band in bands(&lists.offsets, pairs, tiles, most, width) {
        let [first_tile, end_tile] = [band.start, band.end].map(|tile| tile as u32);
        gather_kernel::launch(
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
            layout,
        );
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
