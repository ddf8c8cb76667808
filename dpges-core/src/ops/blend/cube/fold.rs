//! Numbers of a primitive that are summed over pixels, and their sums over a tile for some entries of its list.

use cubecl::prelude::*;

use super::back::{PixelGrad, pixel_grad};
use super::fragments::{FEATURES, Payload, Shape, ShapeExpand, TANGENTS, Tangents};
use crate::footprint::gaussian::cube::add_moments;
use crate::footprint::gaussian::cube::student::student_slopes;
use crate::footprint::gaussian::cube::whitened::{WHITENED_SUMS, add_whitened_sums};
use crate::footprint::moments::MOMENTS;
use crate::footprint::surfel::cube::{DISC_SUMS, DiscPixel, Hit, add_sums};
use crate::gpu::gather::zeros;
use crate::gpu::launch::UNITS;
use crate::gpu::record::Record;
use crate::gpu::tile::pixel_of;
use crate::gpu::vector::scale;
use crate::gpu::view::CameraUniforms;
use crate::ops::blend::Form;
use crate::tiles::binning::cube::TileList;

/// Entries whose sums a cube makes together, and the units that sum over the pixels of each.
pub const ENTRIES: u32 = 4;
const SHARE: u32 = UNITS / ENTRIES;
/// Numbers of an entry at a pixel: gradient of the exponent, covered share, gradient of the depth.
pub const NUMBERS: usize = 3;
/// Units that one unit folds for, and parts of a sum of an entry after that.
const FOLD: usize = 16;
const PARTS: usize = SHARE as usize / FOLD;
/// Sums of the probe: Σ x, Σ y, Σ |x|, Σ |y|.
pub const PROBE: usize = 4;
/// Sums that a cube folds at a time.
// 12 numbers of 256 units take 12 of the 16 KiB of workgroup memory that WebGPU guarantees
pub const GROUP: usize = 12;
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
            Form::Ellipsoids | Form::Students => MOMENTS,
            Form::Discs => DISC_SUMS,
            Form::Whitened => WHITENED_SUMS,
        }
    }

    /// Place among the rest of the gradients that the shape lacks: the depth of ellipsoids, whitened or not; the two coordinates
    /// of the low-pass filter and the exponent of discs; depth, degrees of freedom and exponent of students.
    pub fn beside(self) -> usize {
        3
    }

    pub fn normal(self) -> usize {
        self.beside()
            + match self.form {
                Form::Ellipsoids | Form::Whitened => 1,
                Form::Discs | Form::Students => 3,
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

/// The list of a `tile`, and the place of the first of its slots in a band of tiles that begins with `first_tile`. All units of
/// the cube must call this together.
#[cube]
pub fn list_in_band(offsets: &[u32], tile: u32, first_tile: u32) -> (TileList, u32) {
    let mut range = Shared::<[u32]>::new_slice(3usize);
    if UNIT_POS == 0u32 {
        range[0] = offsets[tile as usize];
        range[1] = offsets[(tile + 1u32) as usize];
        range[2] = offsets[first_tile as usize];
    }
    // WGSL allows barriers in a loop over the list only if its bounds are uniform
    let start = workgroup_uniform_load(&range[0]);
    let length = workgroup_uniform_load(&range[1]) - start;
    let slot = start - workgroup_uniform_load(&range[2]);
    (TileList { start, length }, slot)
}

/// Makes the first of the `ends` of the `units` of a cube, a power of two, the largest. All units of the cube must call this
/// together.
#[cube]
pub fn find_furthest(ends: &mut [u32], #[comptime] units: u32) {
    let unit = UNIT_POS as usize;
    let halvings = comptime!(units.ilog2());
    #[unroll]
    for halving in 0..halvings {
        let step = comptime!((units >> (halving + 1)) as usize);
        sync_cube();
        if unit < step {
            ends[unit] = max(ends[unit], ends[unit + step]);
        }
    }
}

/// A primitive as a pixel sees it.
#[derive(CubeType, Clone, Copy)]
#[expand(derive(Clone, Copy))]
pub struct Seen {
    /// Gradient of the exponent.
    pub power: f32,
    /// αT; below 0 of students that take their colour away
    pub covered: f32,
    pub grad_depth: f32,
    /// For a disc: 1 where its plane and not its low-pass decides, else 0.
    pub by_plane: f32,
}

/// Adds the pixel at (`x`, `y`) px with the gradient `of` its planes to the sums of primitive `i`, in the order of `layout`.
#[cube]
pub fn add_pixel(
    own: &mut Array<f32>,
    shape: Shape,
    features: &[f32],
    i: usize,
    of: &PixelGrad,
    x: f32,
    y: f32,
    seen: Seen,
    view: CameraUniforms,
    #[comptime] layout: Layout,
) {
    let rest = comptime!(layout.shape());
    let beside = comptime!(layout.shape() + layout.beside());
    let normal = comptime!(layout.shape() + layout.normal());
    let probe = comptime!(layout.shape() + layout.probe());
    let (power, covered) = (seen.power, seen.covered);
    let (grad_depth, by_plane) = (seen.grad_depth, seen.by_plane);
    own[rest] += covered * of.colour.x;
    own[rest + 1] += covered * of.colour.y;
    own[rest + 2] += covered * of.colour.z;
    if comptime!(layout.maps) {
        own[normal] += covered * of.normal.x;
        own[normal + 1] += covered * of.normal.y;
        own[normal + 2] += covered * of.normal.z;
    }
    let mut towards_x = 0.0f32;
    let mut towards_y = 0.0f32;
    match shape {
        Shape::Whitened(whitened) => {
            let ray_grad = whitened.pixel_backward(view, x, y, power, grad_depth);
            add_whitened_sums(own, ray_grad, power);
            own[beside] += ray_grad.depth;
            if comptime!(layout.probe) {
                let towards = scale(whitened.towards(ray_grad, view), 0.5f32);
                own[probe] += towards.x;
                own[probe + 1] += towards.y;
                own[probe + 2] += towards.z;
                own[probe + 3] += f32::abs(towards.x) + f32::abs(towards.y) + f32::abs(towards.z);
            }
        }
        Shape::Ellipse(splat) => {
            let (dx, dy) = (x - splat.mean_x, y - splat.mean_y);
            let (u, v) = (splat.u(dx, dy), splat.r * dy);
            add_moments(own, power, u, v);
            own[beside] += grad_depth;
            towards_x = power * splat.p * u;
            towards_y = power * (splat.q * u + splat.r * v);
        }
        Shape::Student(splat, tail) => {
            let (dx, dy) = (x - splat.mean_x, y - splat.mean_y);
            let (u, v) = (splat.u(dx, dy), splat.r * dy);
            let (by_squared, by_degrees) = student_slopes(tail.degrees, u * u + v * v);
            // −2 times the gradient of r²
            let pull = power * by_squared;
            own[beside + 1] += power * by_degrees;
            own[beside + 2] += power;
            add_moments(own, pull, u, v);
            own[beside] += grad_depth;
            towards_x = pull * splat.p * u;
            towards_y = pull * (splat.q * u + splat.r * v);
        }
        Shape::Disc(disc, low_pass) => {
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
            let towards = add_sums(own, on_way, 1.0f32, true, layout.maps);
            let on_screen = 2.0f32 * power * (1.0f32 - by_plane);
            own[beside] += on_screen * (dx - low_pass.offset_x);
            own[beside + 1] += on_screen * (dy - low_pass.offset_y);
            own[beside + 2] += power;
            if comptime!(layout.probe) {
                // gradient of the centre in camera space, over fx and fy: that of T_u.z and T_v.z
                let (ray_x, ray_y) = ((x - view.cx) / view.fx, (y - view.cy) / view.fy);
                let (u, v) = (tangents.u, tangents.v);
                let centre_x = towards.x * (ray_y * v.z - v.y)
                    + towards.y * (u.y - u.z * ray_y)
                    + towards.z * (u.y * v.z - u.z * v.y);
                let centre_y = towards.x * (v.x - ray_x * v.z)
                    + towards.y * (u.z * ray_x - u.x)
                    + towards.z * (u.z * v.x - u.x * v.z);
                let share = by_plane * Payload::load(features, i * FEATURES).depth;
                towards_x = share * centre_x / view.fx;
                towards_y = share * centre_y / view.fy;
            }
        }
    }
    if comptime!(layout.probe && layout.form != Form::Whitened) {
        // normalised device coordinates, for which 3DGS gives its threshold
        let ndc_x = towards_x * f32::cast_from(view.width) * 0.5f32;
        let ndc_y = towards_y * f32::cast_from(view.height) * 0.5f32;
        own[probe] += ndc_x;
        own[probe + 1] += ndc_y;
        own[probe + 2] += f32::abs(ndc_x);
        own[probe + 3] += f32::abs(ndc_y);
    }
}

/// Sums over the pixels of a tile for the last [`ENTRIES`] before place `top` of its `list`, which has
/// its sums from `slot` on, or for as many as there are. `partial` has what each pixel says about them, [[`ENTRIES`],
/// [`NUMBERS`], [`UNITS`]]. All units of the cube must call this together.
#[cube]
pub fn fold_entries(
    partial: &mut [f32],
    sums: &mut [f32],
    shapes: &[f32],
    features: &[f32],
    ids: &[u32],
    grad: &[f32],
    list: TileList,
    top: u32,
    slot: u32,
    tile: u32,
    view: CameraUniforms,
    #[comptime] layout: Layout,
) {
    let width = comptime!(layout.width());
    let groups = comptime!(layout.width().div_ceil(GROUP));
    let unit = UNIT_POS as usize;
    let entries = min(top, ENTRIES);
    // some units sum over the pixels of each entry
    let (entry, member) = (UNIT_POS / SHARE, UNIT_POS % SHARE);
    let mut folded = Shared::<[f32]>::new_slice(comptime!(UNITS as usize / FOLD * GROUP));
    let mut own = zeros(width);
    if entry < entries {
        let i = list.entry(ids, top - 1u32 - entry) as usize;
        let shape = Shape::load(shapes, features, i, layout.form);
        for step in 0..ENTRIES {
            let other = step * SHARE + member;
            let at = entry as usize * NUMBERS * UNITS as usize + other as usize;
            let signed = partial[at + UNITS as usize];
            // a pixel without a fragment covers 0
            if signed != 0.0f32 {
                let mut covered = f32::abs(signed);
                let mut by_plane = select(signed > 0.0f32, 1.0f32, 0.0f32);
                if comptime!(layout.form == Form::Students) {
                    // the sign is that of α: students have no low-pass filter that it could tell from
                    covered = signed;
                    by_plane = 1.0f32;
                }
                let seen = Seen { power: partial[at], covered, grad_depth: partial[at + 2 * UNITS as usize], by_plane };
                let place = pixel_of(view, tile, other);
                let of = pixel_grad(grad, place.at, view, layout.maps);
                add_pixel(&mut own, shape, features, i, &of, place.x, place.y, seen, view, layout);
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
