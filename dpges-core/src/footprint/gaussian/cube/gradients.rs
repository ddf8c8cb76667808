//! Gradients of the parameters of one Gaussian, from the moments of its pixels, on the device.

use cubecl::prelude::*;

use super::Moments;
use super::projection::{MIN_RATIO, Projection, compensation, differences, pairs, root};
use crate::gpu::lens::{LensKind, look_backward};
use crate::gpu::vector::{Quaternion, Vec3, add, apply, cross, dot, scale, times, transpose, turn_backward, vec3};
use crate::gpu::view::CameraUniforms;
use crate::scene::ScreenFilter;

#[derive(CubeType, Clone, Copy)]
#[expand(derive(Clone, Copy))]
pub struct SplatGradient {
    pub position: Vec3,
    pub quaternion: Quaternion,
    pub log_scales: Vec3,
    pub opacity: f32,
}

/// Gradients of the shape, as in the twin.
#[derive(CubeType, Clone, Copy)]
#[expand(derive(Clone, Copy))]
struct ShapeGradient {
    log_scales: Vec3,
    turn: Vec3,
    half0: Vec3,
    half1: Vec3,
}

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
// selected, since 0 times what is infinite is not 0
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
        // computed where it is not taken, too, so that the divisor must not be 0
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
    let turned = apply(transpose(p.rotation), view.rotation.row2);
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

#[cube]
fn lens_backward(view: CameraUniforms, p: Projection, grad_x: f32, grad_y: f32, shape: ShapeGradient) -> Vec3 {
    let (pose, scales) = (view.rotation, scale(p.relative, p.largest));
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

/// Gradients of the raw parameters, from the moments.
#[cube]
pub fn splat_backward(
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
    // only what is not drawn has less, and its sums are 0
    let grad_strength = total / max(strength, 1e-30f32);
    let grad_centre = centre_backward(view, p, grad_x, grad_y, shape);
    SplatGradient {
        position: apply(transpose(view.rotation), grad_centre),
        quaternion: turn_backward(raw_quaternion, shape.turn),
        log_scales: shape.log_scales,
        opacity: select(raw_opacity > 0.0f32, grad_strength * dimming, 0.0f32),
    }
}
