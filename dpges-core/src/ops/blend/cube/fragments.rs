//! Footprint and payload of every primitive, nearest first, and its fragment at a pixel.

use burn::backend::TensorMetadata;
use burn_cubecl::CubeBackend;
use burn_cubecl::tensor::CubeTensor;
use cubecl::prelude::*;

use super::order::{depth_order, tile_keys};
use crate::camera::Camera;
use crate::footprint::gaussian::cube as splat_cube;
use crate::footprint::gaussian::cube::student as student_cube;
use crate::footprint::gaussian::cube::student::{Tail, student_weight};
use crate::footprint::gaussian::cube::whitened as whitened_cube;
use crate::footprint::gaussian::cube::whitened::{WHITENED, Whitened};
use crate::footprint::gaussian::cube::{CUTOFF_F32, INVERSE_CUTOFF, SPLAT, Splat, along_ray};
use crate::footprint::gaussian::tensors::GaussianTensors;
use crate::footprint::surfel::cube as disc_cube;
use crate::footprint::surfel::cube::{
    DiscTensors, MIN_FACING, PLANE, Plane, bounded_scale, disc_of, exact_disc, reach,
};
use crate::gpu::launch::{buffer, cube_dim, empty_f32, empty_u32, units};
use crate::gpu::record::{Record, record};
use crate::gpu::rect::Rect;
use crate::gpu::sort::sorted_pairs;
use crate::gpu::vector::{Mat3, Vec3, dot, rotation, row3, row4, scale, vec3};
use crate::gpu::view::{CameraUniforms, Rests, camera_axes, pixel_range, to_camera, view_depth};
use crate::ops::blend::{BlendLists, BlendOptions, Form};
use crate::scene::{BlendOrder, ScreenFilter};
use crate::tiles::TileGrid;
use crate::tiles::binning::capacity::ListKind;
use crate::tiles::binning::cube::{Ellipses, Pairs, TileList, by_tile, pairs};

/// The low-pass filter is centred in the bounding box of the disc at this squared radius, σ² (2DGS).
pub const LOW_PASS_SQUARED_RADIUS: f32 = 9.0;
/// Offset of a low-pass filter that reaches no pixel, px. Its square is finite.
const NOWHERE: f32 = 1e15;
/// Number of values in a row of features: a [`Payload`], a [`LowPass`] and [`Tangents`]. Ellipsoids have only the
/// first, students a [`Tail`] after it.
pub const FEATURES: usize = TANGENTS + Tangents::LEN;
/// Places of the others in the row.
pub const LOW_PASS: usize = Payload::LEN;
pub const TANGENTS: usize = LOW_PASS + LowPass::LEN;
pub const TAIL: usize = Payload::LEN;

record! {
    /// The values of a primitive that are blended.
    pub struct Payload {
        pub colour: Vec3,
        /// Camera-space z of the centre, world units.
        pub depth: f32,
        /// In camera space, facing the camera.
        pub normal: Vec3,
    }
}

record! {
    /// The low-pass filter of a disc.
    pub struct LowPass {
        /// max(0, opacity) of the disc, 0 behind the near plane.
        pub opacity: f32,
        /// Centre, px from the anchor of the disc.
        pub offset_x: f32,
        pub offset_y: f32,
    }
}

record! {
    /// Axes of a disc in camera space, and its scales along them, world units.
    pub struct Tangents {
        pub u: Vec3,
        pub v: Vec3,
        pub scale_u: f32,
        pub scale_v: f32,
    }
}

/// The axis that is the normal: the first with the smallest scale, or the third axis of a disc.
#[cube]
pub fn normal_axis(log_scales: Vec3, #[comptime] form: Form) -> u32 {
    let mut axis = 2u32;
    if comptime!(form != Form::Discs) {
        // `<=` finds the first of equal scales, as the CPU does
        let first = log_scales.x <= log_scales.y && log_scales.x <= log_scales.z;
        let later = 2u32 - u32::cast_from(log_scales.y <= log_scales.z);
        axis = select(first, 0u32, later);
    }
    axis
}

/// −1 if a normal in camera space must be turned to face the camera, else 1.
#[cube]
pub fn facing_sign(normal: Vec3, centre: Vec3) -> f32 {
    select(dot(normal, centre) > 0.0f32, -1.0f32, 1.0f32)
}

#[cube]
fn row_of(m: Mat3, row: u32) -> Vec3 {
    let (first, second) = (row == 0u32, row == 1u32);
    vec3(
        select(first, m.row0.x, select(second, m.row1.x, m.row2.x)),
        select(first, m.row0.y, select(second, m.row1.y, m.row2.y)),
        select(first, m.row0.z, select(second, m.row1.z, m.row2.z)),
    )
}

/// The row of `axes`, in camera space, that is the normal.
#[cube]
pub fn own_normal(axes: Mat3, log_scales: Vec3, #[comptime] form: Form) -> Vec3 {
    row_of(axes, normal_axis(log_scales, form))
}

#[cube(launch)]
fn features_kernel(
    positions: &[f32],
    quaternions: &[f32],
    log_scales: &[f32],
    opacities: &[f32],
    colours: &[f32],
    order: &[u32],
    features: &mut [f32],
    view: CameraUniforms,
    count: u32,
    #[comptime] form: Form,
) {
    let rank = ABSOLUTE_POS;
    if rank >= count as usize {
        terminate!();
    }
    let i = order[rank] as usize;
    let centre = to_camera(view, row3(positions, i));
    let log_scales = row3(log_scales, i);
    let axes = camera_axes(view, rotation(row4(quaternions, i)));
    let normal = own_normal(axes, log_scales, form);
    let facing = scale(normal, facing_sign(normal, centre));
    let o = rank * FEATURES;
    let payload = Payload { colour: row3(colours, i), depth: view_depth(view, centre), normal: facing };
    Payload::store(payload, features, o);
    if comptime!(form == Form::Discs) {
        let visible = centre.z > view.near;
        let (scale_u, scale_v) = (bounded_scale(log_scales.x), bounded_scale(log_scales.y));
        let (a, b) = (scale(axes.row0, scale_u), scale(axes.row1, scale_v));
        // centre of the box relative to the projected centre, without cancellation of large numbers
        let bulk = LOW_PASS_SQUARED_RADIUS * (a.z * a.z + b.z * b.z) - centre.z * centre.z;
        let bounded = visible && bulk < 0.0f32;
        // both values of `select` are computed, so that the divisor must not be 0
        let factor = LOW_PASS_SQUARED_RADIUS / select(bounded, bulk, -1.0f32);
        let depth = select(visible, centre.z, 1.0f32);
        let (slope_x, slope_y) = (centre.x / depth, centre.y / depth);
        let across = a.z * (a.x - slope_x * a.z) + b.z * (b.x - slope_x * b.z);
        let down = a.z * (a.y - slope_y * a.z) + b.z * (b.y - slope_y * b.z);
        let low_pass = LowPass {
            opacity: select(visible, max(opacities[i], 0.0f32), 0.0f32),
            offset_x: select(bounded, view.fx * factor * across, NOWHERE),
            offset_y: select(bounded, view.fy * factor * down, NOWHERE),
        };
        LowPass::store(low_pass, features, o + LOW_PASS);
        let tangents = Tangents { u: axes.row0, v: axes.row1, scale_u, scale_v };
        Tangents::store(tangents, features, o + TANGENTS);
    }
}

/// Pixels at which a disc can reach 1/255, by its plane or by its low-pass filter.
#[cube(launch)]
fn reach_kernel(
    positions: &[f32],
    quaternions: &[f32],
    log_scales: &[f32],
    features: &[f32],
    order: &[u32],
    rects: &mut [u32],
    view: CameraUniforms,
    rests: Rests,
    count: u32,
) {
    let rank = ABSOLUTE_POS;
    if rank >= count as usize {
        terminate!();
    }
    let i = order[rank] as usize;
    let exact = exact_disc(view, rests, row3(positions, i), row4(quaternions, i));
    let disc = disc_of(view, exact, log_scales[3 * i], log_scales[3 * i + 1]);
    let low_pass = LowPass::load(features, rank * FEATURES + LOW_PASS);
    let strength = low_pass.opacity * INVERSE_CUTOFF;
    let drawn = strength > 1.0f32;
    let squared = 2.0f32 * f32::ln(max(strength, 1.0f32));
    let by_plane = reach(view, disc, select(drawn, f32::sqrt(squared), -1.0f32));
    let x = view.fx * disc.anchor_ray.x + view.cx + low_pass.offset_x;
    let y = view.fy * disc.anchor_ray.y + view.cy + low_pass.offset_y;
    // exp(−ρ / 2) with ρ = 2 |d|²
    // and a little more, since near 8192 px an f32 has steps of 0.001 px
    let radius = f32::sqrt(0.5f32 * squared) + 0.01f32;
    let (x0, x1) = pixel_range(x - radius, x + radius, view.width);
    let (y0, y1) = pixel_range(y - radius, y + radius, view.height);
    let reached = by_plane.is_filled();
    if drawn && x0 < x1 && y0 < y1 {
        let both = Rect {
            x0: select(reached, min(by_plane.x0, x0), x0),
            x1: select(reached, max(by_plane.x1, x1), x1),
            y0: select(reached, min(by_plane.y0, y0), y0),
            y1: select(reached, max(by_plane.y1, y1), y1),
        };
        both.store(rects, rank);
    } else {
        by_plane.store(rects, rank);
    }
}

/// A primitive at a pixel.
#[derive(CubeType, Clone, Copy)]
#[expand(derive(Clone, Copy))]
pub struct Fragment {
    /// α before it is capped, 0 where there is no fragment.
    pub weight: f32,
    /// Camera-space z, world units.
    pub depth: f32,
    /// For a disc: 1 where its plane and not its low-pass decides, else 0.
    pub by_plane: f32,
}

/// An ellipse at the point (`x`, `y`) px.
#[cube]
pub fn on_ellipse(splat: Splat, x: f32, y: f32) -> Fragment {
    let dy = y - splat.mean_y;
    let weight = splat.weight(splat.u(x - splat.mean_x, dy), splat.r * dy);
    Fragment { weight: select(splat.strength > 0.0f32, weight, 0.0f32), depth: splat.depth, by_plane: 1.0f32 }
}

/// A Student's t kernel at the point (`x`, `y`) px.
#[cube]
pub fn on_student(splat: Splat, tail: Tail, x: f32, y: f32) -> Fragment {
    let weight = student_weight(splat, tail, x - splat.mean_x, y - splat.mean_y);
    Fragment { weight: select(splat.strength != 0.0f32, weight, 0.0f32), depth: splat.depth, by_plane: 1.0f32 }
}

/// A disc at the point (`x`, `y`) px.
#[cube]
fn on_disc(plane: Plane, low_pass: LowPass, x: f32, y: f32, near: f32) -> Fragment {
    let found = plane.hit(x, y);
    let dx = x - plane.anchor_x - low_pass.offset_x;
    let dy = y - plane.anchor_y - low_pass.offset_y;
    let on_disc = found.u * found.u + found.v * found.v;
    let on_screen = 2.0f32 * (dx * dx + dy * dy);
    // bounded, since an edge-on disc is met far away and devices may assume that no number is infinite
    let alpha = low_pass.opacity * f32::exp(max(-0.5f32 * min(on_disc, on_screen), -100.0f32));
    let drawn = f32::abs(found.facing) > MIN_FACING && found.depth > near && alpha >= CUTOFF_F32;
    Fragment {
        weight: select(drawn, alpha, 0.0f32),
        depth: select(drawn, found.depth, 1.0f32),
        by_plane: select(drawn && on_disc > on_screen, 0.0f32, 1.0f32),
    }
}

/// The primitive at a `position` of a list, an ellipsoid or a student with the footprint `splat`, at the point (`x`, `y`) px.
#[cube]
pub fn on_projected(
    splat: Splat,
    features: &[f32],
    list: TileList,
    ids: &[u32],
    position: u32,
    x: f32,
    y: f32,
    #[comptime] form: Form,
) -> Fragment {
    if comptime!(form == Form::Students) {
        let i = list.entry(ids, position) as usize;
        on_student(splat, Tail::load(features, i * FEATURES + TAIL), x, y)
    } else {
        on_ellipse(splat, x, y)
    }
}

/// The part of a primitive that does not depend on the pixel.
#[expect(dead_code, reason = "kernels make its expanded twin")]
#[derive(CubeType, Clone, Copy)]
#[expand(derive(Clone, Copy))]
pub enum Shape {
    Ellipse(Splat),
    Student(Splat, Tail),
    Disc(Plane, LowPass),
    Whitened(Whitened),
}

#[cube]
impl Shape {
    /// That of primitive `i`.
    pub fn load(shapes: &[f32], features: &[f32], i: usize, #[comptime] form: Form) -> Shape {
        match form {
            Form::Ellipsoids => Shape::new_Ellipse(Splat::load(shapes, i * SPLAT)),
            Form::Students => {
                Shape::new_Student(Splat::load(shapes, i * SPLAT), Tail::load(features, i * FEATURES + TAIL))
            }
            Form::Discs => {
                Shape::new_Disc(Plane::load(shapes, i * PLANE), LowPass::load(features, i * FEATURES + LOW_PASS))
            }
            Form::Whitened => Shape::new_Whitened(Whitened::load(shapes, i * WHITENED)),
        }
    }

    /// The primitive at the point (`x`, `y`) px.
    pub fn at(self, x: f32, y: f32, view: CameraUniforms) -> Fragment {
        match self {
            Shape::Ellipse(splat) => on_ellipse(splat, x, y),
            Shape::Student(splat, tail) => on_student(splat, tail, x, y),
            Shape::Disc(plane, low_pass) => on_disc(plane, low_pass, x, y, view.near),
            Shape::Whitened(whitened) => {
                let (weight, depth) = whitened.fragment(view, x, y);
                Fragment { weight, depth, by_plane: 1.0f32 }
            }
        }
    }
}

/// The values that do not depend on the pixel; rows are primitives, nearest first.
pub struct Fragments {
    /// [M, [`SPLAT`]] of ellipsoids and students, [M, [`PLANE`]] of discs, [M, [`WHITENED`]] of what rays meet whitened
    pub shapes: CubeTensor,
    /// [M, [`FEATURES`]]
    pub features: CubeTensor,
    /// The result of [`along_ray::table`]; `None` in the order of centres.
    by_rays: Option<CubeTensor>,
}

/// Writes the numbers from 0 on.
#[cube(launch)]
fn numbers_kernel(numbers: &mut [u32], count: u32) {
    if ABSOLUTE_POS >= count as usize {
        terminate!();
    }
    numbers[ABSOLUTE_POS] = ABSOLUTE_POS as u32;
}

/// The value of every pair.
#[cube(launch)]
fn picked_kernel(values: &[u32], pairs: &[u32], out: &mut [u32], count: u32) {
    if ABSOLUTE_POS >= count as usize {
        terminate!();
    }
    out[ABSOLUTE_POS] = values[pairs[ABSOLUTE_POS] as usize];
}

impl Fragments {
    pub fn new(
        gaussians: &GaussianTensors<CubeBackend>,
        degrees_of_freedom: &CubeTensor,
        camera: &Camera,
        options: &BlendOptions,
    ) -> (Self, BlendLists<CubeBackend>) {
        let (like, grid) = (&gaussians.positions, TileGrid::new(camera.width, camera.height));
        let order = depth_order(like, camera);
        let (fragments, rects) = Self::in_order(gaussians, degrees_of_freedom, &order, camera, options);
        let found = match options.form {
            Form::Ellipsoids | Form::Students => {
                let ellipses = Ellipses { splats: &fragments.shapes, ends: &unlimited(like, grid.len()) };
                pairs(&rects, Some(ellipses), camera, ListKind::Gaussians)
            }
            Form::Discs => pairs(&rects, None, camera, ListKind::Discs),
            Form::Whitened => pairs(&rects, None, camera, ListKind::Whitened),
        };
        let keys = fragments.by_rays.as_ref().map(|table| tile_keys(table, &found, camera));
        (fragments, lists(order, &found, keys, grid))
    }

    /// How rays meet every primitive.
    ///
    /// # Panics
    /// In the order of centres.
    pub fn by_rays(&self) -> &CubeTensor {
        self.by_rays.as_ref().expect("in the order of rays")
    }

    /// Fragments in a known `order`, and [M, 4] the pixel rectangles of the primitives.
    pub fn in_order(
        gaussians: &GaussianTensors<CubeBackend>,
        degrees_of_freedom: &CubeTensor,
        order: &CubeTensor,
        camera: &Camera,
        options: &BlendOptions,
    ) -> (Self, CubeTensor) {
        let BlendOptions { form, filter, .. } = *options;
        let (like, count) = (&gaussians.positions, gaussians.positions.shape()[0]);
        let client = like.client.clone();
        let features = empty_f32(like, [count, FEATURES]);
        features_kernel::launch(
            &client,
            units(count),
            cube_dim(),
            buffer(&gaussians.positions),
            buffer(&gaussians.quaternions),
            buffer(&gaussians.log_scales),
            buffer(&gaussians.opacities),
            buffer(&gaussians.colours),
            buffer(order),
            buffer(&features),
            CameraUniforms::launch(camera),
            count as u32,
            form,
        );
        let (shapes, rects) = match form {
            Form::Ellipsoids => splat_cube::splats(gaussians, Some(order), camera, filter),
            Form::Students => {
                // how far a kernel reaches does not depend on its sign
                let magnitudes = magnitudes(gaussians);
                let (ellipses, _) = splat_cube::splats(&magnitudes, Some(order), camera, ScreenFilter::Off);
                let of_kernels = [&gaussians.opacities, degrees_of_freedom, order];
                student_cube::students(of_kernels, &ellipses, &features, TAIL, camera)
            }
            Form::Whitened => whitened_cube::shapes(gaussians, order, camera),
            Form::Discs => {
                let planes = disc_cube::planes(&discs(gaussians), Some(order), None, camera);
                reach_kernel::launch(
                    &client,
                    units(count),
                    cube_dim(),
                    buffer(&gaussians.positions),
                    buffer(&gaussians.quaternions),
                    buffer(&gaussians.log_scales),
                    buffer(&features),
                    buffer(order),
                    buffer(&planes.rects),
                    CameraUniforms::launch(camera),
                    Rests::launch(camera),
                    count as u32,
                );
                (planes.planes, planes.rects)
            }
        };
        let by_rays = match options.order {
            BlendOrder::Centres | BlendOrder::Whitened(_) => None,
            BlendOrder::Rays => Some(along_ray::table(gaussians, order, &shapes, camera)),
        };
        (Self { shapes, features, by_rays }, rects)
    }
}

/// The lists of all tiles, in the order of the primitives and thus front to back, or by the `keys` of the pairs and then in
/// that order.
fn lists(order: CubeTensor, found: &Pairs, keys: Option<CubeTensor>, grid: TileGrid) -> BlendLists<CubeBackend> {
    let (client, count) = (order.client.clone(), found.primitives.shape()[0]);
    // the numbers of the pairs are sorted along, so that the backward pass finds the slot of every pair
    let numbers = empty_u32(&order, [count]);
    numbers_kernel::launch(&client, units(count), cube_dim(), buffer(&numbers), count as u32);
    let (pairs, offsets) = match keys {
        None => found.by_tile(&numbers, grid),
        Some(keys) => {
            // both sorts are stable: sorted by key and then by tile, each tile has the order of its keys
            let (_, numbers) = sorted_pairs(keys, numbers, u32::BITS);
            by_tile(picked(&found.tiles, &numbers), numbers, grid)
        }
    };
    let primitives = picked(&found.primitives, &pairs);
    BlendLists { order, starts: found.starts.clone(), pairs, primitives, offsets }
}

/// The values of every pair, in the order of `pairs`.
fn picked(values: &CubeTensor, pairs: &CubeTensor) -> CubeTensor {
    let count = pairs.shape()[0];
    let out = empty_u32(pairs, [count]);
    picked_kernel::launch(
        &pairs.client.clone(),
        units(count),
        cube_dim(),
        buffer(values),
        buffer(pairs),
        buffer(&out),
        count as u32,
    );
    out
}

/// The same Gaussians with the absolute values of their opacities.
pub fn magnitudes(gaussians: &GaussianTensors<CubeBackend>) -> GaussianTensors<CubeBackend> {
    use burn::backend::ops::FloatTensorOps;
    let opacities = CubeBackend::float_abs(gaussians.opacities.clone());
    GaussianTensors { opacities, ..gaussians.clone() }
}

pub fn discs(gaussians: &GaussianTensors<CubeBackend>) -> DiscTensors<'_> {
    DiscTensors {
        positions: &gaussians.positions,
        quaternions: &gaussians.quaternions,
        log_scales: &gaussians.log_scales,
    }
}

/// [tiles] depths at which tiles end: nowhere.
fn unlimited(like: &CubeTensor, tiles: usize) -> CubeTensor {
    use burn::backend::ops::FloatTensorOps;
    use burn::tensor::{FloatDType, Shape};
    // in sorted blending no depth ends a tile
    CubeBackend::float_full(Shape::from([tiles]), f32::MAX.into(), &like.device, FloatDType::F32)
}
