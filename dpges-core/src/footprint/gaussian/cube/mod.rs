//! One Gaussian seen by one camera, on the device; the CPU's twin is [`super::cpu`].

pub(crate) mod along_ray;
pub(crate) mod regions;
pub(crate) mod student;
pub(crate) mod whitened;

use burn::backend::TensorMetadata;
use burn_cubecl::CubeBackend;
use burn_cubecl::tensor::CubeTensor;
use cubecl::prelude::*;

use super::cpu as splat;
use super::cpu::MIN_COMPENSATION_SQUARED;
use super::tensors::GaussianTensors;
use crate::camera::Camera;
use crate::footprint::CUTOFF;
use crate::footprint::moments::MOMENTS;
use crate::gpu::launch::{buffer, cube_dim, empty_f32, empty_u32, units};
use crate::gpu::lens::{LensKind, look, look_backward};
use crate::gpu::record::{Record, record};
use crate::gpu::rect::{RECT, Rect};
use crate::gpu::tile::TILE;
use crate::gpu::vector::{
    Mat3, Quaternion, Vec3, add, apply, cross, dot, rotation, row3, row4, scale, times, transpose, turn_backward, vec3,
    write3, write4,
};
use crate::gpu::view::{CameraUniforms, pixel_range, to_camera, view_depth, view_rotation};
use crate::scene::ScreenFilter;

const MIN_RATIO: f32 = MIN_COMPENSATION_SQUARED as f32;
pub const CUTOFF_F32: f32 = CUTOFF as f32;
pub const INVERSE_CUTOFF: f32 = (1.0 / CUTOFF) as f32;
const JACOBIAN_MARGIN: f32 = splat::JACOBIAN_MARGIN as f32;
const LEAST_SCALE: f32 = splat::LEAST_SCALE as f32;

/// Number of values in a [`Splat`].
pub const SPLAT: usize = Splat::LEN;

record! {
    /// Footprint: `strength · exp(−½ (u² + v²))` at offset (dx, dy) px from the mean, `u = p dx + q dy`, `v = r dy`.
    pub struct Splat {
        pub mean_x: f32,
        pub mean_y: f32,
        pub p: f32,
        pub q: f32,
        pub r: f32,
        /// Opacity times the compensation for the low-pass filter; 0 if the Gaussian is invisible.
        pub strength: f32,
        /// Depth of the centre, world units.
        pub depth: f32,
        /// Value of u² + v² at the cutoff.
        pub squared_radius: f32,
    }
}

#[cube]
impl Splat {
    /// u at an offset from the mean, px.
    pub fn u(&self, dx: f32, dy: f32) -> f32 {
        self.p * dx + self.q * dy
    }

    /// Value of u² + v² beyond which the weight is below the cutoff, whatever the rounding.
    fn beyond(&self) -> f32 {
        self.squared_radius * 1.001f32 + 0.01f32
    }

    /// Weight at an offset (u, v) in standard deviations, 0 below the cutoff.
    pub fn weight(&self, u: f32, v: f32) -> f32 {
        let squared = u * u + v * v;
        let mut weight = 0.0f32;
        if squared <= self.beyond() {
            let value = self.strength * f32::exp(-0.5f32 * squared);
            weight = select(value >= CUTOFF_F32, value, 0.0f32);
        }
        weight
    }

    /// Whether the ellipse can reach a pixel centre of the tile at a column and row of tiles.
    pub fn touches(&self, column: u32, row: u32) -> bool {
        self.reaches(column * TILE, row * TILE, TILE, TILE)
    }

    /// Whether the ellipse can reach a pixel centre of the rectangle at a column and row of pixels.
    pub fn reaches(&self, column: u32, row: u32, width: u32, height: u32) -> bool {
        let outside = self.nearest(column, row, width, height).squared > self.beyond();
        !outside
    }

    /// Where between the pixel centres of the rectangle at a column and row of pixels the weight is largest.
    pub fn nearest(&self, column: u32, row: u32, width: u32, height: u32) -> Nearest {
        let (p, q, r) = (self.p, self.q, self.r);
        let x0 = f32::cast_from(column) + 0.5f32 - self.mean_x;
        let y0 = f32::cast_from(row) + 0.5f32 - self.mean_y;
        let (x1, y1) = (x0 + f32::cast_from(width - 1u32), y0 + f32::cast_from(height - 1u32));
        let dx = clamp(0.0f32, x0, x1);
        let dy = clamp(0.0f32, y0, y1);
        // the convex form is smallest at the mean or on one of the two edges that face it
        let beside = clamp(-p * q * dx / (q * q + r * r), y0, y1);
        let below = clamp(-q * dy / p, x0, x1);
        let (vertical_u, vertical_v) = (p * dx + q * beside, r * beside);
        let (horizontal_u, horizontal_v) = (p * below + q * dy, r * dy);
        let on_vertical = vertical_u * vertical_u + vertical_v * vertical_v;
        let on_horizontal = horizontal_u * horizontal_u + horizontal_v * horizontal_v;
        let horizontal = on_horizontal < on_vertical;
        Nearest {
            dx: select(horizontal, below, dx),
            dy: select(horizontal, dy, beside),
            squared: min(on_vertical, on_horizontal),
        }
    }
}

/// A point of a rectangle.
#[derive(CubeType, Clone, Copy)]
#[expand(derive(Clone, Copy))]
pub struct Nearest {
    /// Offset from the mean, px.
    pub dx: f32,
    pub dy: f32,
    /// u² + v² there.
    pub squared: f32,
}

record! {
    /// Sums over the pixels of a Gaussian, [`MOMENTS`] numbers: Σ g, Σ g u, Σ g v, Σ g u², Σ g u v, Σ g v², where g is
    /// the gradient of the exponent.
    pub struct Moments {
        pub total: f32,
        pub u: f32,
        pub v: f32,
        pub uu: f32,
        pub uv: f32,
        pub vv: f32,
    }
}

#[cube]
impl Moments {
    /// Whether any pixel contributed.
    pub fn any(&self) -> bool {
        self.total != 0.0f32
            || self.u != 0.0f32
            || self.v != 0.0f32
            || self.uu != 0.0f32
            || self.uv != 0.0f32
            || self.vv != 0.0f32
    }
}

/// Adds a pixel at (u, v) to the first [`MOMENTS`] of a unit's sums.
#[cube]
pub fn add_moments(own: &mut Array<f32>, power: f32, u: f32, v: f32) {
    own[0] += power;
    own[1] += power * u;
    own[2] += power * v;
    own[3] += power * u * u;
    own[4] += power * u * v;
    own[5] += power * v * v;
}

/// The local linear map of a camera at the centre of a Gaussian.
#[derive(CubeType, Clone, Copy)]
#[expand(derive(Clone, Copy))]
struct Local {
    /// Without a lens x / z and y / z, clamped for the Jacobian, and 1 where they were not, else 0; through a lens the
    /// position, px, and 1 where the lens shows it well enough, else 0.
    x: f32,
    y: f32,
    free_x: f32,
    free_y: f32,
    /// Rows of J W over `magnification`, and their cross product.
    plane0: Vec3,
    plane1: Vec3,
    normal: Vec3,
    magnification_x: f32,
    magnification_y: f32,
}

/// Intermediate values of the projection; see the twin for why they are relative to sizes.
#[derive(CubeType, Clone, Copy)]
#[expand(derive(Clone, Copy))]
struct Projection {
    centre: Vec3,
    local: Local,
    rotation: Mat3,
    /// The largest scale, world units, and all scales relative to it.
    largest: f32,
    relative: Vec3,
    /// A, B, C of the filtered covariance, px².
    cov_a: f32,
    cov_b: f32,
    cov_c: f32,
    /// The larger of A and C, px², and its root.
    size: f32,
    length: f32,
    /// Rows of J W R, times the largest scale, over the length.
    axes0: Vec3,
    axes1: Vec3,
    /// Their cross product over the root of the determinant.
    crossed: Vec3,
    /// Variance of the filter over the size.
    low_pass: f32,
    determinant: f32,
    /// Ratio of the determinants, and what it lacks to 1.
    ratio: f32,
    lack: f32,
}

#[cube]
fn pinhole_local(view: CameraUniforms, centre: Vec3) -> Local {
    let z = select(centre.z > view.near, centre.z, 1.0f32);
    let (width, height) = (f32::cast_from(view.width), f32::cast_from(view.height));
    let (margin_x, margin_y) = (JACOBIAN_MARGIN * width / view.fx, JACOBIAN_MARGIN * height / view.fy);
    let (raw_x, raw_y) = (centre.x / z, centre.y / z);
    let slope_x = min(max(raw_x, -view.cx / view.fx - margin_x), (width - view.cx) / view.fx + margin_x);
    let slope_y = min(max(raw_y, -view.cy / view.fy - margin_y), (height - view.cy) / view.fy + margin_y);
    let pose = view_rotation(view);
    let (cofactor0, cofactor1) = (cross(pose.row1, pose.row2), cross(pose.row2, pose.row0));
    let cofactor2 = cross(pose.row0, pose.row1);
    Local {
        x: slope_x,
        y: slope_y,
        free_x: select(raw_x == slope_x, 1.0f32, 0.0f32),
        free_y: select(raw_y == slope_y, 1.0f32, 0.0f32),
        plane0: add(pose.row0, scale(pose.row2, -slope_x)),
        plane1: add(pose.row1, scale(pose.row2, -slope_y)),
        normal: add(cofactor2, add(scale(cofactor0, slope_x), scale(cofactor1, slope_y))),
        magnification_x: view.fx / z,
        magnification_y: view.fy / z,
    }
}

#[cube]
fn lens_local(view: CameraUniforms, centre: Vec3) -> Local {
    let seen = look(view.lens, centre);
    let back = transpose(view_rotation(view));
    let shown = select(seen.shown, 1.0f32, 0.0f32);
    let (plane0, plane1) = (apply(back, seen.row0), apply(back, seen.row1));
    Local {
        x: view.fx * seen.x + view.cx,
        y: view.fy * seen.y + view.cy,
        free_x: shown,
        free_y: shown,
        plane0,
        plane1,
        normal: cross(plane0, plane1),
        magnification_x: view.fx,
        magnification_y: view.fy,
    }
}

#[cube]
fn local(view: CameraUniforms, centre: Vec3) -> Local {
    if comptime!(view.lens.kind == LensKind::None) { pinhole_local(view, centre) } else { lens_local(view, centre) }
}

#[cube]
fn project(
    view: CameraUniforms,
    position: Vec3,
    quaternion: Quaternion,
    log_scales: Vec3,
    #[comptime] filter: ScreenFilter,
) -> Projection {
    let variance = comptime!(filter.variance() as f32);
    let centre = to_camera(view, position);
    let local = local(view, centre);
    let rotation = rotation(quaternion);
    let scales = vec3(f32::exp(log_scales.x), f32::exp(log_scales.y), f32::exp(log_scales.z));
    let largest = max(max(scales.x, scales.y), scales.z);
    let least = max(largest, LEAST_SCALE);
    let relative = vec3(scales.x / least, scales.y / least, scales.z / least);
    let world = transpose(rotation);
    let turned0 = scale(apply(world, local.plane0), local.magnification_x);
    let turned1 = scale(apply(world, local.plane1), local.magnification_y);
    let (half0, half1) = (times(turned0, scales), times(turned1, scales));
    let cov_a = dot(half0, half0) + variance;
    let cov_b = dot(half0, half1);
    let cov_c = dot(half1, half1) + variance;
    let size = max(cov_a, cov_c);
    let length = f32::sqrt(size);
    let per_length = largest / length;
    let (across, down) = (local.magnification_x * per_length, local.magnification_y * per_length);
    let crossed = scale(scale(apply(world, local.normal), across), down);
    // det(Σ + εI) = det Σ + ε tr Σ + ε², every term non-negative: no cancellation for needles
    let minors = times(pairs(relative), crossed);
    let unfiltered = dot(minors, minors);
    let low_pass = variance / size;
    let added = low_pass * (cov_a / size + cov_c / size - low_pass);
    let determinant = unfiltered + added;
    Projection {
        centre,
        local,
        rotation,
        largest,
        relative,
        cov_a,
        cov_b,
        cov_c,
        size,
        length,
        axes0: scale(turned0, per_length),
        axes1: scale(turned1, per_length),
        crossed: scale(crossed, 1.0f32 / f32::sqrt(determinant)),
        low_pass,
        determinant,
        ratio: unfiltered / determinant,
        lack: added / determinant,
    }
}

/// Products of two of three scales, by the axis that is left out.
#[cube]
fn pairs(scales: Vec3) -> Vec3 {
    vec3(scales.y * scales.z, scales.z * scales.x, scales.x * scales.y)
}

/// Differences of the squares of two of three scales, by the axis that is left out.
#[cube]
fn differences(s: Vec3) -> Vec3 {
    vec3((s.y - s.z) * (s.y + s.z), (s.z - s.x) * (s.z + s.x), (s.x - s.y) * (s.x + s.y))
}

#[cube]
fn compensation(p: Projection, #[comptime] filter: ScreenFilter) -> f32 {
    let mut factor = 1.0f32;
    if comptime!(filter == ScreenFilter::Compensated) {
        factor = f32::sqrt(max(p.ratio, MIN_RATIO));
    }
    factor
}

/// p, q and r of a footprint whose projection does not overflow.
#[cube]
fn root(cov_b: f32, cov_c: f32, size: f32, length: f32, determinant: f32) -> Vec3 {
    let across = f32::sqrt(cov_c / size / determinant) / length;
    vec3(across, -across * (cov_b / cov_c), 1.0f32 / f32::sqrt(cov_c))
}

/// Position of the centre, px; `z` is its camera-space z where it is visible.
#[cube]
fn mean(view: CameraUniforms, p: Projection, z: f32) -> (f32, f32) {
    if comptime!(view.lens.kind == LensKind::None) {
        (view.fx * p.centre.x / z + view.cx, view.fy * p.centre.y / z + view.cy)
    } else {
        (p.local.x, p.local.y)
    }
}

/// Whether the camera shows the centre.
#[cube]
fn is_shown(view: CameraUniforms, p: Projection) -> bool {
    let mut shown = view_depth(view, p.centre) > view.near;
    if comptime!(view.lens.kind != LensKind::None) {
        shown = shown && p.local.free_x > 0.5f32;
    }
    shown
}

/// The footprint of a Gaussian and the pixels that it can reach. It reaches none behind the near plane, where a lens does
/// not see, where it stays below the cutoff, and where its projection overflows.
#[cube]
fn splat_of(view: CameraUniforms, p: Projection, opacity: f32, #[comptime] filter: ScreenFilter) -> (Splat, Rect) {
    let strength = max(opacity, 0.0f32) * compensation(p, filter);
    let d = p.determinant;
    let visible = is_shown(view, p) && strength >= CUTOFF_F32 && d > 0.0f32 && p.size < 3e38f32;
    let z = select(visible, p.centre.z, 1.0f32);
    let root = root(
        select(visible, p.cov_b, 0.0f32),
        select(visible, p.cov_c, 1.0f32),
        select(visible, p.size, 1.0f32),
        select(visible, p.length, 1.0f32),
        select(visible, d, 1.0f32),
    );
    let squared = 2.0f32 * f32::ln(max(strength * INVERSE_CUTOFF, 1.0f32));
    let (x, y) = mean(view, p, z);
    let reach = squared * 1.001f32 + 0.01f32;
    let (half_x, half_y) = (f32::sqrt(reach * p.cov_a), f32::sqrt(reach * p.cov_c));
    let slack = 0.01f32;
    let (x0, x1) = pixel_range(x - half_x - slack, x + half_x + slack, view.width);
    let (y0, y1) = pixel_range(y - half_y - slack, y + half_y + slack, view.height);
    let splat = Splat {
        mean_x: x,
        mean_y: y,
        p: root.x,
        q: root.y,
        r: root.z,
        strength: select(visible, strength, 0.0f32),
        depth: view_depth(view, p.centre),
        squared_radius: squared,
    };
    (splat, Rect { x0, x1: select(visible, x1, x0), y0, y1: select(visible, y1, y0) })
}

#[derive(CubeType, Clone, Copy)]
#[expand(derive(Clone, Copy))]
struct SplatGradient {
    position: Vec3,
    quaternion: Quaternion,
    log_scales: Vec3,
    opacity: f32,
}

/// Gradients with respect to the logarithms of the scales, to turns about the axes of the Gaussian, and to the rows of
/// J W R S.
#[derive(CubeType, Clone, Copy)]
#[expand(derive(Clone, Copy))]
struct ShapeGradient {
    log_scales: Vec3,
    turn: Vec3,
    half0: Vec3,
    half1: Vec3,
}

/// The gradients that the exponents of the pixels make.
#[cube]
fn exponent_backward(p: Projection, root: Vec3, moments: Moments) -> ShapeGradient {
    let squares = times(p.relative, p.relative);
    // ∂H = Rᵀ (M (R H)), and how u and v change with the axes, see the twin
    let up = f32::sqrt(p.cov_c / p.size);
    let along = p.low_pass / up / f32::sqrt(p.determinant);
    let v1 = scale(p.axes1, 1.0f32 / up);
    let v0 = add(cross(times(squares, v1), p.crossed), scale(p.axes0, along));
    let n0 = add(scale(v0, moments.uu), scale(v1, moments.uv));
    let n1 = add(scale(v0, moments.uv), scale(v1, moments.vv));
    // Hᵀ ∂H is symmetric: a turn from one axis to another matters as far as their scales differ
    let both = vec3(v0.y * n0.z + v1.y * n1.z, v0.z * n0.x + v1.z * n1.x, v0.x * n0.y + v1.x * n1.y);
    ShapeGradient {
        log_scales: times(squares, add(times(v0, n0), times(v1, n1))),
        turn: times(differences(p.relative), both),
        half0: times(p.relative, scale(n0, root.x)),
        half1: times(p.relative, add(scale(n0, root.y), scale(n1, root.z))),
    }
}

/// The gradients that the ratio of the determinants makes.
#[cube]
fn ratio_backward(p: Projection, grad_ratio: f32) -> ShapeGradient {
    let (relative, a0, a1, crossed) = (p.relative, p.axes0, p.axes1, p.crossed);
    let squares = times(relative, relative);
    let share = p.low_pass / p.determinant;
    let minors = times(pairs(relative), crossed);
    let m = times(minors, minors);
    let s = times(squares, add(times(a0, a0), times(a1, a1)));
    let twice = 2.0f32 * grad_ratio;
    // lack ∂det Σ − ratio ε ∂tr Σ without the terms that cancel
    let log_scales = vec3(
        (s.y + s.z + p.low_pass) * (m.y + m.z) - m.x * s.x,
        (s.z + s.x + p.low_pass) * (m.z + m.x) - m.y * s.y,
        (s.x + s.y + p.low_pass) * (m.x + m.y) - m.z * s.z,
    );
    let of_minors = vec3(
        (relative.x * crossed.y) * (relative.x * crossed.z),
        (relative.y * crossed.z) * (relative.y * crossed.x),
        (relative.z * crossed.x) * (relative.z * crossed.y),
    );
    let of_axes = vec3(a0.y * a0.z + a1.y * a1.z, a0.z * a0.x + a1.z * a1.x, a0.x * a0.y + a1.x * a1.y);
    let both = add(scale(of_minors, -twice * p.lack), scale(of_axes, -twice * p.ratio * share));
    let (by_minors, by_axes) = (p.lack / f32::sqrt(p.determinant), -p.ratio * share);
    let row0 = add(scale(cross(times(squares, a1), crossed), by_minors), scale(a0, by_axes));
    let row1 = add(scale(cross(crossed, times(squares, a0)), by_minors), scale(a1, by_axes));
    ShapeGradient {
        log_scales: scale(log_scales, twice * share),
        turn: times(differences(relative), both),
        half0: scale(times(relative, row0), twice / p.length),
        half1: scale(times(relative, row1), twice / p.length),
    }
}

/// a + b, or a.
#[cube]
fn add_if(condition: bool, a: Vec3, b: Vec3) -> Vec3 {
    vec3(
        a.x + select(condition, b.x, 0.0f32),
        a.y + select(condition, b.y, 0.0f32),
        a.z + select(condition, b.z, 0.0f32),
    )
}

#[cube]
fn shape_backward(p: Projection, root: Vec3, moments: Moments, #[comptime] filter: ScreenFilter) -> ShapeGradient {
    let shape = exponent_backward(p, root, moments);
    if comptime!(filter == ScreenFilter::Compensated) {
        let compensates = p.ratio > MIN_RATIO;
        let of_ratio = ratio_backward(p, 0.5f32 * moments.total / max(p.ratio, MIN_RATIO));
        ShapeGradient {
            log_scales: add_if(compensates, shape.log_scales, of_ratio.log_scales),
            turn: add_if(compensates, shape.turn, of_ratio.turn),
            half0: add_if(compensates, shape.half0, of_ratio.half0),
            half1: add_if(compensates, shape.half1, of_ratio.half1),
        }
    } else {
        shape
    }
}

/// Gradient with respect to the centre in camera axes from those with respect to the mean, px, and to the shape.
#[cube]
fn pinhole_backward(view: CameraUniforms, p: Projection, grad_x: f32, grad_y: f32, shape: ShapeGradient) -> Vec3 {
    let z = p.centre.z;
    let turned = apply(transpose(p.rotation), view_rotation(view).row2);
    let depths = times(turned, scale(p.relative, p.largest));
    // row 0 of J W = fx / z (W₀ − s_x W₂), s_x = x / z unless clamped; 1 / z acts like all scales at once
    let grad_slope_x = -p.local.free_x * view.fx / z * dot(shape.half0, depths);
    let grad_slope_y = -p.local.free_y * view.fy / z * dot(shape.half1, depths);
    let centre_x = grad_slope_x / z + view.fx / z * grad_x;
    let centre_y = grad_slope_y / z + view.fy / z * grad_y;
    let centre_z = -(shape.log_scales.x + shape.log_scales.y + shape.log_scales.z) / z
        - grad_slope_x * p.local.x / z
        - grad_slope_y * p.local.y / z
        - view.fx * p.centre.x / (z * z) * grad_x
        - view.fy * p.centre.y / (z * z) * grad_y;
    vec3(centre_x, centre_y, centre_z)
}

/// [`pinhole_backward`] through a lens.
#[cube]
fn lens_backward(view: CameraUniforms, p: Projection, grad_x: f32, grad_y: f32, shape: ShapeGradient) -> Vec3 {
    let (pose, scales) = (view_rotation(view), scale(p.relative, p.largest));
    let plane0 = apply(p.rotation, times(scales, shape.half0));
    let plane1 = apply(p.rotation, times(scales, shape.half1));
    let (row0, row1) = (scale(apply(pose, plane0), view.fx), scale(apply(pose, plane1), view.fy));
    look_backward(view.lens, p.centre, view.fx * grad_x, view.fy * grad_y, row0, row1)
}

#[cube]
fn centre_backward(view: CameraUniforms, p: Projection, grad_x: f32, grad_y: f32, shape: ShapeGradient) -> Vec3 {
    if comptime!(view.lens.kind == LensKind::None) {
        pinhole_backward(view, p, grad_x, grad_y, shape)
    } else {
        lens_backward(view, p, grad_x, grad_y, shape)
    }
}

/// From the moments to the raw parameters.
#[cube]
fn splat_backward(
    view: CameraUniforms,
    p: Projection,
    raw_quaternion: Quaternion,
    raw_opacity: f32,
    moments: Moments,
    #[comptime] filter: ScreenFilter,
) -> SplatGradient {
    let total = moments.total;
    let root = root(p.cov_b, p.cov_c, p.size, p.length, p.determinant);
    let (grad_x, grad_y) = (root.x * moments.u, root.y * moments.u + root.z * moments.v);
    let shape = shape_backward(p, root, moments, filter);
    let dimming = compensation(p, filter);
    let strength = max(raw_opacity, 0.0f32) * dimming;
    let grad_strength = total / max(strength, 1e-30f32);
    let grad_centre = centre_backward(view, p, grad_x, grad_y, shape);
    SplatGradient {
        position: apply(transpose(view_rotation(view)), grad_centre),
        quaternion: turn_backward(raw_quaternion, shape.turn),
        log_scales: shape.log_scales,
        opacity: select(raw_opacity > 0.0f32, grad_strength * dimming, 0.0f32),
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
    view: CameraUniforms,
    count: u32,
    #[comptime] ordered: bool,
    #[comptime] filter: ScreenFilter,
) {
    let rank = ABSOLUTE_POS;
    if rank >= count as usize {
        terminate!();
    }
    let mut i = rank;
    if comptime!(ordered) {
        i = order[rank] as usize;
    }
    let projection = project(view, row3(positions, i), row4(quaternions, i), row3(log_scales, i), filter);
    let (splat, rect) = splat_of(view, projection, opacities[i], filter);
    Splat::store(splat, splats, rank * SPLAT);
    rect.store(rects, rank);
}

#[cube(launch)]
fn place_backward_kernel(
    positions: &[f32],
    quaternions: &[f32],
    log_scales: &[f32],
    opacities: &[f32],
    moments: &[f32],
    grad_positions: &mut [f32],
    grad_opacities: &mut [f32],
    view: CameraUniforms,
    count: u32,
    #[comptime] filter: ScreenFilter,
) {
    let i = ABSOLUTE_POS;
    if i >= count as usize {
        terminate!();
    }
    let moments = Moments::load(moments, i * MOMENTS);
    // an invisible Gaussian has no projection to differentiate
    if moments.any() {
        let gradient = gradient(positions, quaternions, log_scales, opacities, moments, view, i, filter);
        write3(grad_positions, i, gradient.position);
        grad_opacities[i] = gradient.opacity;
    } else {
        write3(grad_positions, i, vec3(0.0f32, 0.0f32, 0.0f32));
        grad_opacities[i] = 0.0f32;
    }
}

#[cube(launch)]
fn shape_backward_kernel(
    positions: &[f32],
    quaternions: &[f32],
    log_scales: &[f32],
    opacities: &[f32],
    moments: &[f32],
    grad_quaternions: &mut [f32],
    grad_log_scales: &mut [f32],
    view: CameraUniforms,
    count: u32,
    #[comptime] filter: ScreenFilter,
) {
    let i = ABSOLUTE_POS;
    if i >= count as usize {
        terminate!();
    }
    let moments = Moments::load(moments, i * MOMENTS);
    if moments.any() {
        let gradient = gradient(positions, quaternions, log_scales, opacities, moments, view, i, filter);
        write4(grad_quaternions, i, gradient.quaternion);
        write3(grad_log_scales, i, gradient.log_scales);
    } else {
        write4(grad_quaternions, i, Quaternion { w: 0.0f32, x: 0.0f32, y: 0.0f32, z: 0.0f32 });
        write3(grad_log_scales, i, vec3(0.0f32, 0.0f32, 0.0f32));
    }
}

/// Gradients of one Gaussian. Two kernels write them, because one kernel would need more buffers than
/// every device has.
#[cube]
fn gradient(
    positions: &[f32],
    quaternions: &[f32],
    log_scales: &[f32],
    opacities: &[f32],
    moments: Moments,
    view: CameraUniforms,
    i: usize,
    #[comptime] filter: ScreenFilter,
) -> SplatGradient {
    let quaternion = row4(quaternions, i);
    let projection = project(view, row3(positions, i), quaternion, row3(log_scales, i), filter);
    splat_backward(view, projection, quaternion, opacities[i], moments, filter)
}

/// Splats [M, [`SPLAT`]] and pixel rectangles [M, [`RECT`]] of `gaussians`. Row i is Gaussian i, or Gaussian
/// `order[i]` with an `order` [M].
pub fn splats(
    gaussians: &GaussianTensors<CubeBackend>,
    order: Option<&CubeTensor>,
    camera: &Camera,
    filter: ScreenFilter,
) -> (CubeTensor, CubeTensor) {
    let like = &gaussians.positions;
    let count = like.shape()[0];
    let (splats, rects) = (empty_f32(like, [count, SPLAT]), empty_u32(like, [count, RECT]));
    splats_kernel::launch(
        &like.client.clone(),
        units(count),
        cube_dim(),
        buffer(&gaussians.positions),
        buffer(&gaussians.quaternions),
        buffer(&gaussians.log_scales),
        buffer(&gaussians.opacities),
        buffer(order.unwrap_or(&empty_u32(like, [1]))),
        buffer(&splats),
        buffer(&rects),
        CameraUniforms::launch(camera),
        count as u32,
        order.is_some(),
        filter,
    );
    (splats, rects)
}

/// Writes the gradients with respect to positions, quaternions, log-scales and opacities into `out`, from
/// the `moments` [M, [`MOMENTS`]].
pub fn backward(
    gaussians: &GaussianTensors<CubeBackend>,
    moments: &CubeTensor,
    camera: &Camera,
    filter: ScreenFilter,
    out: &GaussianTensors<CubeBackend>,
) {
    let (client, count) = (moments.client.clone(), moments.shape()[0]);
    place_backward_kernel::launch(
        &client,
        units(count),
        cube_dim(),
        buffer(&gaussians.positions),
        buffer(&gaussians.quaternions),
        buffer(&gaussians.log_scales),
        buffer(&gaussians.opacities),
        buffer(moments),
        buffer(&out.positions),
        buffer(&out.opacities),
        CameraUniforms::launch(camera),
        count as u32,
        filter,
    );
    shape_backward_kernel::launch(
        &client,
        units(count),
        cube_dim(),
        buffer(&gaussians.positions),
        buffer(&gaussians.quaternions),
        buffer(&gaussians.log_scales),
        buffer(&gaussians.opacities),
        buffer(moments),
        buffer(&out.quaternions),
        buffer(&out.log_scales),
        CameraUniforms::launch(camera),
        count as u32,
        filter,
    );
}
