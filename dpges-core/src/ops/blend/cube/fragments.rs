//! What the kernels know of every primitive, nearest first, and its value at a pixel.

use burn::backend::TensorMetadata;
use burn_cubecl::CubeBackend;
use burn_cubecl::tensor::CubeTensor;
use cubecl::prelude::*;

use super::order::{depth_order, sorted};
use crate::binning::capacity::ListKind;
use crate::binning::cube::{CubeLists, Ellipses, SPLAT, bin};
use crate::camera::Camera;
use crate::footprint::CUTOFF;
use crate::footprint::disc::MIN_FACING;
use crate::footprint::disc_cube::{LARGEST_LOG_SCALE, PLANE, disc, exact_disc, hit, write_plane, write_reach};
use crate::footprint::gaussians::GaussianTensors;
use crate::footprint::splat_cube::{project, weight as splat_weight, write_splat};
use crate::gpu::launch::{buffer, cube_dim, empty_f32, empty_u32, units};
use crate::gpu::vector::{Mat3, Vec3, apply, dot, rotation, row3, row4, scale, transpose, vec3};
use crate::gpu::view::{Rests, View, pixel_range, to_camera, view_rotation};
use crate::ops::blend::Form;
use crate::tiles::TileGrid;

const CUTOFF_F32: f32 = CUTOFF as f32;
const INVERSE_CUTOFF: f32 = (1.0 / CUTOFF) as f32;
const MIN_FACING_F32: f32 = MIN_FACING as f32;
/// Squared radius, σ², of the disc whose bounding box the screen low-pass is centred in (2DGS).
pub const LOW_PASS_SQUARED_RADIUS: f32 = 9.0;
/// Offset, px, of a low-pass that reaches no pixel; its square is finite.
const NOWHERE: f32 = 1e15;

/// Numbers of a primitive beside its shape, at these places.
pub const FEATURES: usize = 18;
/// Camera-space z of the centre; the colour comes before it.
pub const DEPTH: usize = 3;
/// In camera space, facing the camera.
pub const NORMAL: usize = 4;
/// Of a disc: max(0, opacity), 0 behind the near plane; an ellipsoid's is in its splat.
pub const OPACITY: usize = 7;
/// Of a disc: centre of its low-pass, px from its anchor.
pub const OFFSET: usize = 8;
/// Of a disc: t_u and t_v in camera space.
pub const TANGENTS: usize = 10;
/// Of a disc: along t_u and t_v, world units.
pub const SCALES: usize = 16;

/// The axis that is the normal: of the smallest scale, the first of several, or a disc's third.
#[cube]
pub fn normal_axis(log_scales: Vec3, #[comptime] form: Form) -> u32 {
    let mut axis = 2u32;
    if comptime!(form == Form::Ellipsoids) {
        let first = log_scales.x <= log_scales.y && log_scales.x <= log_scales.z;
        let later = 2u32 - u32::cast_from(log_scales.y <= log_scales.z);
        axis = select(first, 0u32, later);
    }
    axis
}

/// −1 where a normal, given in camera space, is turned to face the camera, else 1.
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

/// Axes of a primitive in camera space, by rows.
#[cube]
pub fn camera_axes(view: View, world: Mat3) -> Mat3 {
    let (pose, axes) = (view_rotation(view), transpose(world));
    Mat3 { row0: apply(pose, axes.row0), row1: apply(pose, axes.row1), row2: apply(pose, axes.row2) }
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
    view: View,
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
    let colour = row3(colours, i);
    let o = rank * FEATURES;
    features[o] = colour.x;
    features[o + 1] = colour.y;
    features[o + 2] = colour.z;
    features[o + DEPTH] = centre.z;
    features[o + NORMAL] = facing.x;
    features[o + NORMAL + 1] = facing.y;
    features[o + NORMAL + 2] = facing.z;
    if comptime!(form == Form::Discs) {
        let visible = centre.z > view.near;
        features[o + OPACITY] = select(visible, max(opacities[i], 0.0f32), 0.0f32);
        let scale_u = f32::exp(min(log_scales.x, LARGEST_LOG_SCALE));
        let scale_v = f32::exp(min(log_scales.y, LARGEST_LOG_SCALE));
        let (a, b) = (scale(axes.row0, scale_u), scale(axes.row1, scale_v));
        // centre of the box, relative to the projected centre: nothing large cancels
        let bulk = LOW_PASS_SQUARED_RADIUS * (a.z * a.z + b.z * b.z) - centre.z * centre.z;
        let bounded = visible && bulk < 0.0f32;
        let factor = LOW_PASS_SQUARED_RADIUS / select(bounded, bulk, -1.0f32);
        let depth = select(visible, centre.z, 1.0f32);
        let (slope_x, slope_y) = (centre.x / depth, centre.y / depth);
        let across = a.z * (a.x - slope_x * a.z) + b.z * (b.x - slope_x * b.z);
        let down = a.z * (a.y - slope_y * a.z) + b.z * (b.y - slope_y * b.z);
        features[o + OFFSET] = select(bounded, view.fx * factor * across, NOWHERE);
        features[o + OFFSET + 1] = select(bounded, view.fy * factor * down, NOWHERE);
        features[o + TANGENTS] = axes.row0.x;
        features[o + TANGENTS + 1] = axes.row0.y;
        features[o + TANGENTS + 2] = axes.row0.z;
        features[o + TANGENTS + 3] = axes.row1.x;
        features[o + TANGENTS + 4] = axes.row1.y;
        features[o + TANGENTS + 5] = axes.row1.z;
        features[o + SCALES] = scale_u;
        features[o + SCALES + 1] = scale_v;
    }
}

#[cube(launch)]
fn splats_kernel(
    positions: &[f32],
    quaternions: &[f32],
    log_scales: &[f32],
    opacities: &[f32],
    order: &[u32],
    splats: &mut [f32],
    rects: &mut [u32],
    view: View,
    count: u32,
) {
    let rank = ABSOLUTE_POS;
    if rank >= count as usize {
        terminate!();
    }
    let i = order[rank] as usize;
    let projection = project(view, row3(positions, i), row4(quaternions, i), row3(log_scales, i));
    write_splat(view, projection, opacities[i], splats, rects, rank);
}

#[cube(launch)]
fn planes_kernel(
    positions: &[f32],
    quaternions: &[f32],
    log_scales: &[f32],
    order: &[u32],
    planes: &mut [f32],
    lows: &mut [f32],
    view: View,
    rests: Rests,
    count: u32,
) {
    let rank = ABSOLUTE_POS;
    if rank >= count as usize {
        terminate!();
    }
    let i = order[rank] as usize;
    let exact = exact_disc(view, rests, row3(positions, i), row4(quaternions, i));
    let disc = disc(view, exact, log_scales[3 * i], log_scales[3 * i + 1]);
    write_plane(view, rests, exact, disc, planes, lows, rank);
}

/// Pixels that a disc can reach at 1/255, by its plane or by its low-pass. The box around a disc that
/// crosses the near plane is that of the square around it.
#[cube(launch)]
fn reach_kernel(
    positions: &[f32],
    quaternions: &[f32],
    log_scales: &[f32],
    features: &[f32],
    order: &[u32],
    rects: &mut [u32],
    view: View,
    rests: Rests,
    count: u32,
) {
    let rank = ABSOLUTE_POS;
    if rank >= count as usize {
        terminate!();
    }
    let i = order[rank] as usize;
    let exact = exact_disc(view, rests, row3(positions, i), row4(quaternions, i));
    let disc = disc(view, exact, log_scales[3 * i], log_scales[3 * i + 1]);
    let o = rank * FEATURES;
    let strength = features[o + OPACITY] * INVERSE_CUTOFF;
    let drawn = strength > 1.0f32;
    let squared = 2.0f32 * f32::ln(max(strength, 1.0f32));
    write_reach(view, disc, select(drawn, f32::sqrt(squared), -1.0f32), rects, rank);
    let x = view.fx * disc.anchor_ray.x + view.cx + features[o + OFFSET];
    let y = view.fy * disc.anchor_ray.y + view.cy + features[o + OFFSET + 1];
    // exp(−ρ / 2) with ρ = 2 |d|²
    let radius = f32::sqrt(0.5f32 * squared) + 0.01f32;
    let (x0, x1) = pixel_range(x - radius, x + radius, view.width);
    let (y0, y1) = pixel_range(y - radius, y + radius, view.height);
    let r = rank * 4;
    let reached = rects[r] < rects[r + 1] && rects[r + 2] < rects[r + 3];
    if drawn && x0 < x1 && y0 < y1 {
        rects[r] = select(reached, min(rects[r], x0), x0);
        rects[r + 1] = select(reached, max(rects[r + 1], x1), x1);
        rects[r + 2] = select(reached, min(rects[r + 2], y0), y0);
        rects[r + 3] = select(reached, max(rects[r + 3], y1), y1);
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
    /// Of a disc: 1 where its plane and not its low-pass decides, else 0.
    pub by_plane: f32,
}

/// Primitive `i` at the point (`x`, `y`) px.
#[cube]
pub fn fragment(
    shapes: &[f32],
    features: &[f32],
    i: usize,
    x: f32,
    y: f32,
    near: f32,
    #[comptime] form: Form,
) -> Fragment {
    let mut weight = 0.0f32;
    let mut depth = 1.0f32;
    let mut by_plane = 1.0f32;
    if comptime!(form == Form::Ellipsoids) {
        let o = i * SPLAT;
        // one that is not visible has no conic
        if shapes[o + 5] > 0.0f32 {
            weight = splat_weight(shapes, o, x - shapes[o], y - shapes[o + 1]);
            depth = shapes[o + 6];
        }
    } else {
        let (o, f) = (i * PLANE, i * FEATURES);
        let found = hit(shapes, o, x, y);
        let dx = x - shapes[o] - features[f + OFFSET];
        let dy = y - shapes[o + 1] - features[f + OFFSET + 1];
        let on_disc = found.u * found.u + found.v * found.v;
        let on_screen = 2.0f32 * (dx * dx + dy * dy);
        let alpha = features[f + OPACITY] * f32::exp(max(-0.5f32 * min(on_disc, on_screen), -100.0f32));
        if f32::abs(found.facing) > MIN_FACING_F32 && found.depth > near && alpha >= CUTOFF_F32 {
            weight = alpha;
            depth = found.depth;
            by_plane = select(on_disc <= on_screen, 1.0f32, 0.0f32);
        }
    }
    Fragment { weight, depth, by_plane }
}

/// What does not depend on the pixel; rows are primitives, nearest first.
pub struct Fragments {
    /// [M] index of each in the parameters
    pub order: CubeTensor,
    /// [M, [`SPLAT`]] of ellipsoids, [M, [`PLANE`]] of discs
    pub shapes: CubeTensor,
    /// [M, [`FEATURES`]]
    pub features: CubeTensor,
    /// [M, 4] pixel rectangles
    pub rects: CubeTensor,
    /// In ascending order, thus front to back.
    pub lists: CubeLists,
}

impl Fragments {
    pub fn new(gaussians: &GaussianTensors<CubeBackend>, camera: &Camera, form: Form) -> Self {
        let (like, count) = (&gaussians.positions, gaussians.positions.shape()[0]);
        let (client, tiles) = (like.client.clone(), TileGrid::new(camera.width, camera.height).len());
        let order = depth_order(like, camera);
        let (features, rects) = (empty_f32(like, [count, FEATURES]), empty_u32(like, [count, 4]));
        features_kernel::launch(
            &client,
            units(count),
            cube_dim(),
            buffer(&gaussians.positions),
            buffer(&gaussians.quaternions),
            buffer(&gaussians.log_scales),
            buffer(&gaussians.opacities),
            buffer(&gaussians.colours),
            buffer(&order),
            buffer(&features),
            View::launch(camera),
            count as u32,
            form,
        );
        let (shapes, lists) = match form {
            Form::Ellipsoids => {
                let splats = empty_f32(like, [count, SPLAT]);
                splats_kernel::launch(
                    &client,
                    units(count),
                    cube_dim(),
                    buffer(&gaussians.positions),
                    buffer(&gaussians.quaternions),
                    buffer(&gaussians.log_scales),
                    buffer(&gaussians.opacities),
                    buffer(&order),
                    buffer(&splats),
                    buffer(&rects),
                    View::launch(camera),
                    count as u32,
                );
                let ends = unlimited(like, tiles);
                let ellipses = Ellipses { splats: &splats, ends: &ends };
                let lists = bin(&rects, Some(ellipses), camera, ListKind::Gaussians);
                (splats, lists)
            }
            Form::Discs => {
                let (planes, lows) = (empty_f32(like, [count, PLANE]), empty_f32(like, [count, PLANE]));
                planes_kernel::launch(
                    &client,
                    units(count),
                    cube_dim(),
                    buffer(&gaussians.positions),
                    buffer(&gaussians.quaternions),
                    buffer(&gaussians.log_scales),
                    buffer(&order),
                    buffer(&planes),
                    buffer(&lows),
                    View::launch(camera),
                    Rests::launch(camera),
                    count as u32,
                );
                reach_kernel::launch(
                    &client,
                    units(count),
                    cube_dim(),
                    buffer(&gaussians.positions),
                    buffer(&gaussians.quaternions),
                    buffer(&gaussians.log_scales),
                    buffer(&features),
                    buffer(&order),
                    buffer(&rects),
                    View::launch(camera),
                    Rests::launch(camera),
                    count as u32,
                );
                (planes, bin(&rects, None, camera, ListKind::Surfels))
            }
        };
        Self { order, shapes, features, rects, lists: sorted(lists, tiles) }
    }
}

/// [tiles] depths at which tiles end: nowhere.
fn unlimited(like: &CubeTensor, tiles: usize) -> CubeTensor {
    use burn::backend::ops::FloatTensorOps;
    use burn::tensor::{FloatDType, Shape};
    CubeBackend::float_full(Shape::from([tiles]), f32::MAX.into(), &like.device, FloatDType::F32)
}
