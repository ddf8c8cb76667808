//! One Gaussian seen by one camera, on the device; the CPU's twin is [`super::splat`].

use cubecl::prelude::*;

use super::CUTOFF;
use super::splat::{self, LOW_PASS, MIN_COMPENSATION_SQUARED};
use crate::binning::cube::SPLAT;
use crate::gpu::vector::{
    Mat3, Quaternion, Vec3, add, apply, cross, dot, rotation, rotation_backward, scale, transpose, vec3,
};
use crate::gpu::view::{View, pixel_range, to_camera, view_rotation};

const LOW_PASS_F32: f32 = LOW_PASS as f32;
const MIN_RATIO: f32 = MIN_COMPENSATION_SQUARED as f32;
pub const CUTOFF_F32: f32 = CUTOFF as f32;
const INVERSE_CUTOFF: f32 = (1.0 / CUTOFF) as f32;
const JACOBIAN_MARGIN: f32 = splat::JACOBIAN_MARGIN as f32;
/// Sums over the pixels of a Gaussian: the moments of the gradient of the exponent.
pub const MOMENTS: usize = 6;

#[derive(CubeType, Clone, Copy)]
#[expand(derive(Clone, Copy))]
pub struct Projection {
    pub centre: Vec3,
    /// x / z and y / z, clamped for the Jacobian, and 1 where they were not, else 0.
    pub slope_x: f32,
    pub slope_y: f32,
    pub free_x: f32,
    pub free_y: f32,
    pub rotation: Mat3,
    pub scales: Vec3,
    /// Rows of J W.
    pub plane0: Vec3,
    pub plane1: Vec3,
    /// Rows of J W R S.
    pub half0: Vec3,
    pub half1: Vec3,
    /// A, B, C of the filtered covariance, px².
    pub cov_a: f32,
    pub cov_b: f32,
    pub cov_c: f32,
    pub determinant: f32,
    pub minors: Vec3,
    pub ratio: f32,
}

#[cube]
pub fn project(view: View, position: Vec3, quaternion: Quaternion, log_scales: Vec3) -> Projection {
    let centre = to_camera(view, position);
    let z = select(centre.z > view.near, centre.z, 1.0f32);
    let (width, height) = (f32::cast_from(view.width), f32::cast_from(view.height));
    let (margin_x, margin_y) = (JACOBIAN_MARGIN * width / view.fx, JACOBIAN_MARGIN * height / view.fy);
    let (raw_x, raw_y) = (centre.x / z, centre.y / z);
    let slope_x = min(max(raw_x, -view.cx / view.fx - margin_x), (width - view.cx) / view.fx + margin_x);
    let slope_y = min(max(raw_y, -view.cy / view.fy - margin_y), (height - view.cy) / view.fy + margin_y);
    let pose = view_rotation(view);
    let plane0 = scale(add(pose.row0, scale(pose.row2, -slope_x)), view.fx / z);
    let plane1 = scale(add(pose.row1, scale(pose.row2, -slope_y)), view.fy / z);
    let rotation = rotation(quaternion);
    let scales = vec3(f32::exp(log_scales.x), f32::exp(log_scales.y), f32::exp(log_scales.z));
    let axes = transpose(rotation);
    let turned0 = apply(axes, plane0);
    let turned1 = apply(axes, plane1);
    let half0 = vec3(turned0.x * scales.x, turned0.y * scales.y, turned0.z * scales.z);
    let half1 = vec3(turned1.x * scales.x, turned1.y * scales.y, turned1.z * scales.z);
    let cov_a = dot(half0, half0) + LOW_PASS_F32;
    let cov_b = dot(half0, half1);
    let cov_c = dot(half1, half1) + LOW_PASS_F32;
    let minors = cross(half0, half1);
    // det(Σ + εI) = det Σ + ε tr Σ + ε², every term non-negative: no cancellation for needles
    let unfiltered = dot(minors, minors);
    let determinant = unfiltered + LOW_PASS_F32 * (cov_a + cov_c - LOW_PASS_F32);
    Projection {
        centre,
        slope_x,
        slope_y,
        free_x: select(raw_x == slope_x, 1.0f32, 0.0f32),
        free_y: select(raw_y == slope_y, 1.0f32, 0.0f32),
        rotation,
        scales,
        plane0,
        plane1,
        half0,
        half1,
        cov_a,
        cov_b,
        cov_c,
        determinant,
        minors,
        ratio: unfiltered / determinant,
    }
}

#[cube]
pub fn compensation(p: Projection) -> f32 {
    f32::sqrt(max(p.ratio, MIN_RATIO))
}

/// Row `i` of `splats` and of `rects`: an empty rectangle behind the near plane, below the cutoff
/// everywhere, or where the projection overflows.
#[cube]
pub fn write_splat(view: View, p: Projection, opacity: f32, splats: &mut [f32], rects: &mut [u32], i: usize) {
    let strength = max(opacity, 0.0f32) * compensation(p);
    let d = p.determinant;
    let visible = p.centre.z > view.near && strength >= CUTOFF_F32 && d > 0.0f32 && d < 3e38f32;
    let z = select(visible, p.centre.z, 1.0f32);
    let inverse = 1.0f32 / select(visible, d, 1.0f32);
    let squared = 2.0f32 * f32::ln(max(strength * INVERSE_CUTOFF, 1.0f32));
    let x = view.fx * p.centre.x / z + view.cx;
    let y = view.fy * p.centre.y / z + view.cy;
    let o = i * SPLAT;
    splats[o] = x;
    splats[o + 1] = y;
    splats[o + 2] = p.cov_c * inverse;
    splats[o + 3] = -p.cov_b * inverse;
    splats[o + 4] = p.cov_a * inverse;
    splats[o + 5] = select(visible, strength, 0.0f32);
    splats[o + 6] = p.centre.z;
    splats[o + 7] = squared;
    let reach = squared * 1.001f32 + 0.01f32;
    let (half_x, half_y) = (f32::sqrt(reach * p.cov_a), f32::sqrt(reach * p.cov_c));
    let slack = 0.01f32;
    let (x0, x1) = pixel_range(x - half_x - slack, x + half_x + slack, view.width);
    let (y0, y1) = pixel_range(y - half_y - slack, y + half_y + slack, view.height);
    rects[4 * i] = x0;
    rects[4 * i + 1] = select(visible, x1, x0);
    rects[4 * i + 2] = y0;
    rects[4 * i + 3] = select(visible, y1, y0);
}

/// Weight at an offset from the mean of the splat at `o`, 0 below the cutoff.
#[cube]
pub fn weight(splats: &[f32], o: usize, dx: f32, dy: f32) -> f32 {
    let power = -0.5f32 * (splats[o + 2] * dx * dx + splats[o + 4] * dy * dy) - splats[o + 3] * dx * dy;
    let weight = splats[o + 5] * f32::exp(clamp(power, -100.0f32, 0.0f32));
    select(weight >= CUTOFF_F32, weight, 0.0f32)
}

#[derive(CubeType, Clone, Copy)]
#[expand(derive(Clone, Copy))]
pub struct SplatGradient {
    pub position: Vec3,
    pub quaternion: Quaternion,
    pub log_scales: Vec3,
    pub opacity: f32,
}

/// From the moments in row `i` to the raw parameters.
#[cube]
pub fn splat_backward(
    view: View,
    p: Projection,
    raw_quaternion: Quaternion,
    raw_opacity: f32,
    moments: &[f32],
    i: usize,
) -> SplatGradient {
    let o = i * MOMENTS;
    let (total, mx, my) = (moments[o], moments[o + 1], moments[o + 2]);
    let (mxx, mxy, myy) = (moments[o + 3], moments[o + 4], moments[o + 5]);
    let inverse = 1.0f32 / p.determinant;
    let (a, b, c) = (p.cov_c * inverse, -p.cov_b * inverse, p.cov_a * inverse);
    let (grad_x, grad_y) = (a * mx + b * my, b * mx + c * my);
    // ∂Q = −½ Σ g d dᵀ, ∂Σ = −Q ∂Q Q
    let direct_a = 0.5f32 * (a * a * mxx + 2.0f32 * a * b * mxy + b * b * myy);
    let direct_b = a * b * mxx + (a * c + b * b) * mxy + b * c * myy;
    let direct_c = 0.5f32 * (b * b * mxx + 2.0f32 * b * c * mxy + c * c * myy);

    let dimming = compensation(p);
    let opacity = max(raw_opacity, 0.0f32);
    let strength = opacity * dimming;
    let grad_strength = total / max(strength, 1e-30f32);
    let live = select(p.ratio > MIN_RATIO, 1.0f32, 0.0f32);
    let grad_unfiltered = live * grad_strength * opacity * 0.5f32 / dimming * inverse;
    let grad_determinant = -grad_unfiltered * p.ratio;
    let ga = direct_a + grad_determinant * p.cov_c;
    let gb = direct_b - 2.0f32 * grad_determinant * p.cov_b;
    let gc = direct_c + grad_determinant * p.cov_a;
    let grad_minors = scale(p.minors, 2.0f32 * grad_unfiltered);
    let grad_half0 = add(cross(p.half1, grad_minors), add(scale(p.half0, 2.0f32 * ga), scale(p.half1, gb)));
    let grad_half1 = add(cross(grad_minors, p.half0), add(scale(p.half1, 2.0f32 * gc), scale(p.half0, gb)));

    // half = plane · R S
    let r = p.rotation;
    let s = p.scales;
    let factor = Mat3 {
        row0: vec3(r.row0.x * s.x, r.row0.y * s.y, r.row0.z * s.z),
        row1: vec3(r.row1.x * s.x, r.row1.y * s.y, r.row1.z * s.z),
        row2: vec3(r.row2.x * s.x, r.row2.y * s.y, r.row2.z * s.z),
    };
    let of0 = add(scale(grad_half0, p.plane0.x), scale(grad_half1, p.plane1.x));
    let of1 = add(scale(grad_half0, p.plane0.y), scale(grad_half1, p.plane1.y));
    let of2 = add(scale(grad_half0, p.plane0.z), scale(grad_half1, p.plane1.z));
    let log_scales = vec3(
        of0.x * factor.row0.x + of1.x * factor.row1.x + of2.x * factor.row2.x,
        of0.y * factor.row0.y + of1.y * factor.row1.y + of2.y * factor.row2.y,
        of0.z * factor.row0.z + of1.z * factor.row1.z + of2.z * factor.row2.z,
    );
    let grad_rotation = Mat3 {
        row0: vec3(of0.x * s.x, of0.y * s.y, of0.z * s.z),
        row1: vec3(of1.x * s.x, of1.y * s.y, of1.z * s.z),
        row2: vec3(of2.x * s.x, of2.y * s.y, of2.z * s.z),
    };

    // plane row 0 = fx / z (W₀ − s_x W₂), s_x = x / z unless clamped
    let z = p.centre.z;
    let pose = view_rotation(view);
    let grad_plane0 = apply(factor, grad_half0);
    let grad_plane1 = apply(factor, grad_half1);
    let grad_slope_x = -p.free_x * view.fx / z * dot(grad_plane0, pose.row2);
    let grad_slope_y = -p.free_y * view.fy / z * dot(grad_plane1, pose.row2);
    let centre_x = grad_slope_x / z + view.fx / z * grad_x;
    let centre_y = grad_slope_y / z + view.fy / z * grad_y;
    let centre_z = -dot(grad_plane0, p.plane0) / z
        - dot(grad_plane1, p.plane1) / z
        - grad_slope_x * p.slope_x / z
        - grad_slope_y * p.slope_y / z
        - view.fx * p.centre.x / (z * z) * grad_x
        - view.fy * p.centre.y / (z * z) * grad_y;
    SplatGradient {
        position: apply(transpose(pose), vec3(centre_x, centre_y, centre_z)),
        quaternion: rotation_backward(raw_quaternion, grad_rotation),
        log_scales,
        opacity: select(raw_opacity > 0.0f32, grad_strength * dimming, 0.0f32),
    }
}
