//! The projection of one Gaussian onto the picture of one camera, on the device.

use cubecl::prelude::*;

use super::super::cpu;
use super::{CUTOFF_F32, INVERSE_CUTOFF, Splat};
use crate::gpu::lens::{LensKind, look};
use crate::gpu::rect::Rect;
use crate::gpu::vector::{Mat3, Quaternion, Vec3, add, apply, cross, dot, rotation, scale, times, transpose, vec3};
use crate::gpu::view::{CameraUniforms, pixels_within, to_camera, view_depth};
use crate::scene::ScreenFilter;

pub const MIN_RATIO: f32 = cpu::MIN_COMPENSATION_SQUARED as f32;
const JACOBIAN_MARGIN: f32 = cpu::JACOBIAN_MARGIN as f32;
const LEAST_SCALE: f32 = cpu::LEAST_SCALE as f32;

/// The local linear map of a camera at the centre of a Gaussian.
#[derive(CubeType, Clone, Copy)]
#[expand(derive(Clone, Copy))]
pub struct Local {
    /// Without a lens x / z and y / z, clamped for the Jacobian, and 1 where they were not, else 0; through a lens the
    /// position, px, and 1 where the lens shows it well enough, else 0.
    pub x: f32,
    pub y: f32,
    pub free_x: f32,
    pub free_y: f32,
    /// Rows of J W over `magnification`, and their cross product.
    pub plane0: Vec3,
    pub plane1: Vec3,
    pub normal: Vec3,
    pub magnification_x: f32,
    pub magnification_y: f32,
}

/// Intermediate values of the projection; see the twin for why they are relative to sizes.
#[derive(CubeType, Clone, Copy)]
#[expand(derive(Clone, Copy))]
pub struct Projection {
    pub centre: Vec3,
    pub local: Local,
    pub rotation: Mat3,
    /// The largest scale, world units, and all scales relative to it.
    pub largest: f32,
    pub relative: Vec3,
    /// A, B, C of the filtered covariance, px².
    pub cov_a: f32,
    pub cov_b: f32,
    pub cov_c: f32,
    /// The larger of A and C, px², and its root.
    pub size: f32,
    pub length: f32,
    /// Rows of J W R, times the largest scale, over the length.
    pub axes0: Vec3,
    pub axes1: Vec3,
    /// Their cross product over the root of the determinant.
    pub crossed: Vec3,
    /// Variance of the filter over the size.
    pub low_pass: f32,
    pub determinant: f32,
    /// Ratio of the determinants, and what it lacks to 1.
    pub ratio: f32,
    pub lack: f32,
}

#[cube]
fn pinhole_local(view: CameraUniforms, centre: Vec3) -> Local {
    // what is behind the near plane is not drawn; a depth of 1 keeps its numbers finite
    let z = select(centre.z > view.near, centre.z, 1.0f32);
    let (width, height) = (f32::cast_from(view.width), f32::cast_from(view.height));
    let (margin_x, margin_y) = (JACOBIAN_MARGIN * width / view.fx, JACOBIAN_MARGIN * height / view.fy);
    let (raw_x, raw_y) = (centre.x / z, centre.y / z);
    let slope_x = min(max(raw_x, -view.cx / view.fx - margin_x), (width - view.cx) / view.fx + margin_x);
    let slope_y = min(max(raw_y, -view.cy / view.fy - margin_y), (height - view.cy) / view.fy + margin_y);
    let pose = view.rotation;
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
    let back = transpose(view.rotation);
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
pub fn project(
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
    // scales may vanish in f32, and 0 / 0 is no scale
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
    // one factor after the other: their product may overflow or vanish where the result does not
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
pub fn pairs(scales: Vec3) -> Vec3 {
    vec3(scales.y * scales.z, scales.z * scales.x, scales.x * scales.y)
}

/// Differences of the squares of two of three scales, by the axis that is left out.
#[cube]
pub fn differences(s: Vec3) -> Vec3 {
    // a factor of the difference, not a difference of squares, whose digits cancel for equal scales
    vec3((s.y - s.z) * (s.y + s.z), (s.z - s.x) * (s.z + s.x), (s.x - s.y) * (s.x + s.y))
}

#[cube]
pub fn compensation(p: Projection, #[comptime] filter: ScreenFilter) -> f32 {
    let mut factor = 1.0f32;
    if comptime!(filter == ScreenFilter::Compensated) {
        factor = f32::sqrt(max(p.ratio, MIN_RATIO));
    }
    factor
}

/// p, q and r of a footprint whose projection does not overflow.
#[cube]
pub fn root(cov_b: f32, cov_c: f32, size: f32, length: f32, determinant: f32) -> Vec3 {
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
pub fn splat_of(view: CameraUniforms, p: Projection, opacity: f32, #[comptime] filter: ScreenFilter) -> (Splat, Rect) {
    // steps of Adam may push a linear opacity below 0
    let strength = max(opacity, 0.0f32) * compensation(p, filter);
    let d = p.determinant;
    // 3e38 in place of infinity, which WGSL does not have as a constant
    let visible = is_shown(view, p) && strength >= CUTOFF_F32 && d > 0.0f32 && p.size < 3e38f32;
    let z = select(visible, p.centre.z, 1.0f32);
    let root = root(
        // the root of what is not drawn is that of a circle of 1 px, so that no kernel divides by 0
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
    // near 8192 px an f32 has steps of 0.001 px
    let slack = 0.01f32;
    let (x0, x1) = (x - half_x - slack, x + half_x + slack);
    let (y0, y1) = (y - half_y - slack, y + half_y + slack);
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
    (splat, pixels_within(view, visible, x0, x1, y0, y1))
}
