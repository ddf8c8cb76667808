//! A lens on the device; the CPU's twin is [`crate::camera::Lens`].

mod matrix;
mod range;

use cubecl::prelude::*;

pub use range::{Range, aside_ranges, plus, times};

use super::vector::{Vec3, add, dot, scale, sin_cos, vec3};
use crate::camera::{Camera, Distortion, Projection};
use matrix::{Mat2, product, sum, transposed};

/// Steps of Newton's method that find the undistorted radius of a position, and then the position itself.
// where Newton's method leaves the bracket at every step, 20 halvings still find the radius to a millionth of it
const RADIAL_STEPS: u32 = 20;
const TANGENTIAL_STEPS: u32 = 8;
/// Below this ratio (ρ / z)² the angle is a series.
// there the closed forms are differences of nearly equal numbers; of the series about 1e-7 is left out
const SERIES_BELOW: f32 = 0.05;
const PI: f32 = std::f32::consts::PI;

/// The kind of lens that a kernel is compiled for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum LensKind {
    /// A pinhole.
    None,
    /// Depth is camera-space z.
    Perspective,
    /// `r = atan2(κ sin θ, cos θ) / ω`; depth is the distance from the camera's centre.
    Arc,
}

/// Coefficients and limits of a lens, see [`crate::camera::Distortion`].
#[derive(CubeType, CubeLaunch, Clone, Copy)]
#[expand(derive(Clone, Copy))]
pub struct LensUniforms {
    numerator: (f32, f32, f32, f32, f32, f32),
    denominator: (f32, f32, f32),
    tangential: (f32, f32),
    thin_prism: (f32, f32),
    thin_prism_quartic: (f32, f32),
    /// κ and ω.
    arc: (f32, f32),
    /// Largest undistorted radius that it sees, and where it appears without what is tangential.
    pub limit: f32,
    radial_limit: f32,
    /// [`Camera::coverage`]
    coverage: f32,
    #[cube(comptime)]
    pub kind: LensKind,
    /// Whether positions stay on their radius.
    #[cube(comptime)]
    pub is_radial: bool,
    /// Whether positions leave their radius after it has changed.
    #[cube(comptime)]
    pub in_sequence: bool,
}

impl LensUniforms {
    pub fn launch(camera: &Camera) -> LensUniformsLaunch {
        let Some(lens) = &camera.lens else { return Self::none() };
        let kind = if lens.is_wide() { LensKind::Arc } else { LensKind::Perspective };
        let limits = [lens.limit(), lens.radial(lens.limit()), camera.coverage()];
        Self::of(lens.distortion(), kind, lens.arc().unwrap_or([1.0; 2]), limits)
    }

    /// Uniforms of a pinhole.
    pub fn none() -> LensUniformsLaunch {
        Self::of(&Distortion::new(Projection::Perspective), LensKind::None, [0.0; 2], [0.0; 3])
    }

    fn of(distortion: &Distortion, kind: LensKind, arc: [f64; 2], limits: [f64; 3]) -> LensUniformsLaunch {
        let &Distortion { tangential, thin_prism, thin_prism_quartic, in_sequence, .. } = distortion;
        let is_radial = [tangential, thin_prism, thin_prism_quartic] == [[0.0; 2]; 3];
        let two = |numbers: [f64; 2]| numbers.map(|v| v as f32).into();
        let [limit, radial_limit, coverage] = limits.map(|v| v as f32);
        LensUniformsLaunch::new(
            distortion.numerator.map(|v| v as f32).into(),
            distortion.denominator.map(|v| v as f32).into(),
            two(tangential),
            two(thin_prism),
            two(thin_prism_quartic),
            two(arc),
            limit,
            radial_limit,
            coverage,
            kind,
            is_radial,
            in_sequence,
        )
    }
}

/// Angle in [0, π] between a direction and an axis, of its components across, `away` ≥ 0, and `along` the axis; to f32
/// accuracy, which WGSL does not guarantee. Reduces to [0, tan π/8] and evaluates a polynomial (Cephes).
#[cube]
pub fn angle(away: f32, along: f32) -> f32 {
    let size = f32::abs(along);
    // the vector 0 gets the angle 0, not 0 / 0
    let ratio = min(away, size) / max(max(away, size), 1e-30f32);
    let far = ratio > 0.414_213_57f32;
    let reduced = select(far, (ratio - 1.0f32) / (ratio + 1.0f32), ratio);
    let squared = reduced * reduced;
    let tail = ((8.053_744_5e-2f32 * squared - 0.138_776_86f32) * squared + 0.199_777_11f32) * squared - 0.333_329_5f32;
    let small = tail * squared * reduced + reduced;
    let within = select(far, small + 0.25f32 * PI, small);
    let acute = select(away > size, 0.5f32 * PI - within, within);
    select(along < 0.0f32, PI - acute, acute)
}

/// Factor of the radius at r² = `m`, and its first two derivatives with respect to m.
#[cube]
fn factor(lens: LensUniforms, m: f32) -> Vec3 {
    let (n1, n2, n3, n4, n5, n6) = lens.numerator;
    let (d1, d2, d3) = lens.denominator;
    let n = 1.0f32 + m * (n1 + m * (n2 + m * (n3 + m * (n4 + m * (n5 + m * n6)))));
    let high_slope = 4.0f32 * n4 + m * (5.0f32 * n5 + m * 6.0f32 * n6);
    let n_slope = n1 + m * (2.0f32 * n2 + m * (3.0f32 * n3 + m * high_slope));
    let high_bend = 12.0f32 * n4 + m * (20.0f32 * n5 + m * 30.0f32 * n6);
    let n_bend = 2.0f32 * n2 + m * (6.0f32 * n3 + m * high_bend);
    let d = 1.0f32 + m * (d1 + m * (d2 + m * d3));
    let d_slope = d1 + m * (2.0f32 * d2 + m * 3.0f32 * d3);
    let d_bend = 2.0f32 * d2 + m * 6.0f32 * d3;
    let value = n / d;
    let slope = (n_slope - value * d_slope) / d;
    vec3(value, slope, (n_bend - 2.0f32 * slope * d_slope - value * d_bend) / d)
}

/// Distorted radius at an undistorted one, without what is tangential.
#[cube]
pub fn radial(lens: LensUniforms, radius: f32) -> f32 {
    let factor = factor(lens, radius * radius);
    radius * factor.x
}

/// Undistorted radius at an angle from the optical axis; very large where the lens cannot see.
#[cube]
pub fn radius_at(lens: LensUniforms, angle_from_axis: f32) -> f32 {
    let (sin, cos) = sin_cos(angle_from_axis);
    if comptime!(lens.kind == LensKind::Arc) {
        let (kappa, omega) = lens.arc;
        angle(max(kappa * sin, 0.0f32), cos) / omega
    } else {
        // both values of `select` are computed: the divisor stays away from 0 where the other one is taken, too
        select(cos > 1e-3f32, sin / max(cos, 1e-3f32), 1e30f32)
    }
}

/// Tangential and thin-prism shift of a position: 2 p₁ u v + p₂ (r² + 2u²) + s₁ r² + t₁ r⁴ and its twin.
#[cube]
fn aside(lens: LensUniforms, u: f32, v: f32) -> (f32, f32) {
    let (p1, p2) = lens.tangential;
    let (s1, s2) = lens.thin_prism;
    let (t1, t2) = lens.thin_prism_quartic;
    let m = u * u + v * v;
    (
        2.0f32 * p1 * u * v + p2 * (m + 2.0f32 * u * u) + (s1 + t1 * m) * m,
        p1 * (m + 2.0f32 * v * v) + 2.0f32 * p2 * u * v + (s2 + t2 * m) * m,
    )
}

/// The position at which the shift is evaluated, for an undistorted position whose radius has this factor.
#[cube]
fn moved_aside(lens: LensUniforms, a: f32, b: f32, factor: f32) -> (f32, f32) {
    if comptime!(lens.in_sequence) { (a * factor, b * factor) } else { (a, b) }
}

/// Position of an undistorted position.
#[cube]
fn distort(lens: LensUniforms, a: f32, b: f32) -> (f32, f32) {
    let factor = factor(lens, a * a + b * b);
    let (u, v) = moved_aside(lens, a, b, factor.x);
    let (x, y) = aside(lens, u, v);
    (a * factor.x + x, b * factor.x + y)
}

/// Jacobian of [`aside`].
#[cube]
fn aside_jacobian(lens: LensUniforms, u: f32, v: f32) -> Mat2 {
    let (p1, p2) = lens.tangential;
    let (s1, s2) = lens.thin_prism;
    let (t1, t2) = lens.thin_prism_quartic;
    let m = 2.0f32 * (u * u + v * v);
    let (prism_x, prism_y) = (2.0f32 * (s1 + m * t1), 2.0f32 * (s2 + m * t2));
    Mat2 {
        xx: 2.0f32 * p1 * v + (6.0f32 * p2 + prism_x) * u,
        xy: 2.0f32 * p1 * u + (2.0f32 * p2 + prism_x) * v,
        yx: (2.0f32 * p1 + prism_y) * u + 2.0f32 * p2 * v,
        yy: (6.0f32 * p1 + prism_y) * v + 2.0f32 * p2 * u,
    }
}

/// Gradient with respect to (u, v) from that with respect to [`aside_jacobian`].
#[cube]
fn aside_jacobian_backward(lens: LensUniforms, u: f32, v: f32, grad: Mat2) -> (f32, f32) {
    let (p1, p2) = lens.tangential;
    let (s1, s2) = lens.thin_prism;
    let (t1, t2) = lens.thin_prism_quartic;
    let m = u * u + v * v;
    let along = grad.xx * t1 + grad.yx * t2;
    let across = grad.xy * t1 + grad.yy * t2;
    let form = 8.0f32 * (along * u + across * v);
    let of_u = grad.xx * (6.0f32 * p2 + 2.0f32 * s1)
        + grad.xy * 2.0f32 * p1
        + grad.yx * (2.0f32 * p1 + 2.0f32 * s2)
        + grad.yy * 2.0f32 * p2;
    let of_v = grad.xx * 2.0f32 * p1
        + grad.xy * (2.0f32 * p2 + 2.0f32 * s1)
        + grad.yx * 2.0f32 * p2
        + grad.yy * (6.0f32 * p1 + 2.0f32 * s2);
    (of_u + 4.0f32 * m * along + form * u, of_v + 4.0f32 * m * across + form * v)
}

/// Jacobian of what the radius alone does, which is symmetric.
#[cube]
fn radial_jacobian(a: f32, b: f32, value: f32, slope: f32) -> Mat2 {
    let across = 2.0f32 * a * b * slope;
    Mat2 { xx: value + 2.0f32 * a * a * slope, xy: across, yx: across, yy: value + 2.0f32 * b * b * slope }
}

#[cube]
fn distort_jacobian(lens: LensUniforms, a: f32, b: f32) -> Mat2 {
    let factor = factor(lens, a * a + b * b);
    let radial = radial_jacobian(a, b, factor.x, factor.y);
    let (u, v) = moved_aside(lens, a, b, factor.x);
    let aside = aside_jacobian(lens, u, v);
    if comptime!(lens.in_sequence) { sum(radial, product(aside, radial)) } else { sum(radial, aside) }
}

/// Gradient with respect to (a, b) from that with respect to the Jacobian of what the radius alone does.
#[cube]
fn radial_jacobian_backward(a: f32, b: f32, slope: f32, bend: f32, grad: Mat2) -> (f32, f32) {
    let mixed = grad.xy + grad.yx;
    let form = 2.0f32 * (grad.xx * a * a + mixed * a * b + grad.yy * b * b);
    let common = 2.0f32 * (slope * (grad.xx + grad.yy) + bend * form);
    (
        a * common + slope * (4.0f32 * grad.xx * a + 2.0f32 * mixed * b),
        b * common + slope * (4.0f32 * grad.yy * b + 2.0f32 * mixed * a),
    )
}

/// Gradient with respect to (a, b) from that with respect to the Jacobian.
#[cube]
fn distort_jacobian_backward(lens: LensUniforms, a: f32, b: f32, grad: Mat2) -> (f32, f32) {
    let factor = factor(lens, a * a + b * b);
    let (slope, bend) = (factor.y, factor.z);
    let (u, v) = moved_aside(lens, a, b, factor.x);
    if comptime!(lens.in_sequence) {
        // J = (1 + S(u, v)) R(a, b)
        let radial = radial_jacobian(a, b, factor.x, slope);
        let grad_radial = sum(grad, product(transposed(aside_jacobian(lens, u, v)), grad));
        let (of_a, of_b) = radial_jacobian_backward(a, b, slope, bend, grad_radial);
        let (of_u, of_v) = aside_jacobian_backward(lens, u, v, product(grad, radial));
        (of_a + radial.xx * of_u + radial.yx * of_v, of_b + radial.xy * of_u + radial.yy * of_v)
    } else {
        let (of_a, of_b) = radial_jacobian_backward(a, b, slope, bend, grad);
        let (of_u, of_v) = aside_jacobian_backward(lens, u, v, grad);
        (of_a + of_u, of_b + of_v)
    }
}

/// The factor s of (a, b) = s (x, y), and its derivatives with respect to w = x² + y² and z.
#[derive(CubeType, Clone, Copy)]
#[expand(derive(Clone, Copy))]
struct LensScale {
    s: f32,
    w: f32,
    z: f32,
    ww: f32,
    wz: f32,
    zz: f32,
}

#[cube]
fn perspective_scale(z: f32) -> LensScale {
    let s = 1.0f32 / select(z > 0.0f32, z, 1.0f32);
    LensScale { s, w: 0.0f32, z: -s * s, ww: 0.0f32, wz: 0.0f32, zz: 2.0f32 * s * s * s }
}

#[cube]
fn arc_scale(lens: LensUniforms, across: f32, z: f32) -> LensScale {
    let (kappa, omega) = lens.arc;
    let square = kappa * kappa;
    let gain = kappa / omega;
    let w = square * across;
    let squared = max(w + z * z, 1e-30f32);
    let near_axis = z > 0.0f32 && w < SERIES_BELOW * z * z;
    // θ / ρ by the series of the arctangent
    let depth = select(near_axis, z, 1.0f32);
    let m = select(near_axis, w / (depth * depth), 0.0f32);
    let s0 = 1.0f32
        + m * (-1.0f32 / 3.0f32
            + m * (1.0f32 / 5.0f32
                + m * (-1.0f32 / 7.0f32 + m * (1.0f32 / 9.0f32 + m * (-1.0f32 / 11.0f32 + m / 13.0f32)))));
    let s1 = -1.0f32 / 3.0f32
        + m * (2.0f32 / 5.0f32
            + m * (-3.0f32 / 7.0f32 + m * (4.0f32 / 9.0f32 + m * (-5.0f32 / 11.0f32 + m * 6.0f32 / 13.0f32))));
    let s2 = 2.0f32 / 5.0f32
        + m * (-6.0f32 / 7.0f32
            + m * (12.0f32 / 9.0f32 + m * (-20.0f32 / 11.0f32 + m * (30.0f32 / 13.0f32 + m * (-42.0f32 / 15.0f32)))));
    let cube = depth * depth * depth;
    // and by its definition
    let far = select(near_axis, 1.0f32, max(w, 1e-30f32));
    let root = f32::sqrt(far);
    let own = angle(root, z) / root;
    let own_w = (z / squared - own) / (2.0f32 * far);
    let own_ww = (-z / (squared * squared) - 3.0f32 * own_w) / (2.0f32 * far);
    LensScale {
        s: gain * select(near_axis, s0 / depth, own),
        w: gain * square * select(near_axis, s1 / cube, own_w),
        z: -gain / squared,
        ww: gain * square * square * select(near_axis, s2 / (cube * depth * depth), own_ww),
        wz: gain * square / (squared * squared),
        zz: gain * 2.0f32 * z / (squared * squared),
    }
}

#[cube]
fn lens_scale(lens: LensUniforms, across: f32, z: f32) -> LensScale {
    if comptime!(lens.kind == LensKind::Arc) { arc_scale(lens, across, z) } else { perspective_scale(z) }
}

/// A point seen through a lens: [`crate::camera::Seen`].
#[derive(CubeType, Clone, Copy)]
#[expand(derive(Clone, Copy))]
pub struct Seen {
    /// Focal lengths from the principal point.
    pub x: f32,
    pub y: f32,
    /// Rows of the Jacobian, focal lengths per world unit.
    pub row0: Vec3,
    pub row1: Vec3,
    /// Whether the lens shows the point, well enough for a Gaussian.
    pub shown: bool,
}

/// Rows of the Jacobian of the undistorted position.
#[cube]
fn inner_rows(point: Vec3, s: LensScale) -> (Vec3, Vec3) {
    let across = 2.0f32 * point.x * point.y * s.w;
    (
        vec3(s.s + 2.0f32 * point.x * point.x * s.w, across, point.x * s.z),
        vec3(across, s.s + 2.0f32 * point.y * point.y * s.w, point.y * s.z),
    )
}

/// A point in camera axes as the lens shows it.
#[cube]
pub fn look(lens: LensUniforms, point: Vec3) -> Seen {
    let s = lens_scale(lens, point.x * point.x + point.y * point.y, point.z);
    let (a, b) = (s.s * point.x, s.s * point.y);
    let mut shown = a * a + b * b <= lens.limit * lens.limit;
    if comptime!(lens.kind == LensKind::Perspective) {
        shown = shown && point.z > 0.0f32;
    }
    // far outside the limit the polynomials may overflow; at 0 all numbers of a point that is not shown are finite
    let (a, b) = (select(shown, a, 0.0f32), select(shown, b, 0.0f32));
    let (inner0, inner1) = inner_rows(point, s);
    let outer = distort_jacobian(lens, a, b);
    let (x, y) = distort(lens, a, b);
    let covered = x * x + y * y <= lens.coverage * lens.coverage;
    Seen {
        x,
        y,
        row0: add(scale(inner0, outer.xx), scale(inner1, outer.xy)),
        row1: add(scale(inner0, outer.yx), scale(inner1, outer.yy)),
        shown: shown && covered,
    }
}

/// Gradient with respect to a point that the lens shows, from those with respect to its [`Seen`].
#[cube]
pub fn look_backward(lens: LensUniforms, point: Vec3, grad_x: f32, grad_y: f32, grad0: Vec3, grad1: Vec3) -> Vec3 {
    let s = lens_scale(lens, point.x * point.x + point.y * point.y, point.z);
    let (a, b) = (s.s * point.x, s.s * point.y);
    let (inner0, inner1) = inner_rows(point, s);
    let outer = distort_jacobian(lens, a, b);
    let grad_outer =
        Mat2 { xx: dot(grad0, inner0), xy: dot(grad0, inner1), yx: dot(grad1, inner0), yy: dot(grad1, inner1) };
    let first = add(scale(grad0, outer.xx), scale(grad1, outer.yx));
    let second = add(scale(grad0, outer.xy), scale(grad1, outer.yy));
    let (bent_a, bent_b) = distort_jacobian_backward(lens, a, b, grad_outer);
    let towards_a = outer.xx * grad_x + outer.yx * grad_y + bent_a;
    let towards_b = outer.xy * grad_x + outer.yy * grad_y + bent_b;
    // of the inner Jacobian: q s + 2 p s_w + l s_z
    let mixed = first.y + second.x;
    let q = first.x + second.y;
    let p = first.x * point.x * point.x + mixed * point.x * point.y + second.y * point.y * point.y;
    let l = first.z * point.x + second.z * point.y;
    let common = 2.0f32 * (q * s.w + 2.0f32 * p * s.ww + l * s.wz);
    let own = vec3(
        point.x * common + 2.0f32 * s.w * (2.0f32 * first.x * point.x + mixed * point.y) + first.z * s.z,
        point.y * common + 2.0f32 * s.w * (mixed * point.x + 2.0f32 * second.y * point.y) + second.z * s.z,
        q * s.z + 2.0f32 * p * s.wz + l * s.zz,
    );
    add(own, add(scale(inner0, towards_a), scale(inner1, towards_b)))
}

/// The undistorted radius of a distorted one up to the limit, by Newton's method within a bracket.
#[cube]
fn inverse_radial(lens: LensUniforms, target: f32) -> f32 {
    let mut low = 0.0f32;
    let mut high = lens.limit;
    let mut radius = min(target, lens.limit);
    let mut step = 0u32;
    while step < RADIAL_STEPS {
        let m = radius * radius;
        let factor = factor(lens, m);
        let excess = radius * factor.x - target;
        let above = excess > 0.0f32;
        high = select(above, radius, high);
        low = select(above, low, radius);
        let newton = radius - excess / (factor.x + 2.0f32 * m * factor.y);
        // a slope of 0 makes `newton` infinite or NaN, which is in no bracket: then the bracket is halved
        let bracketed = newton >= low && newton <= high;
        radius = select(bracketed, newton, 0.5f32 * (low + high));
        step += 1u32;
    }
    radius
}

/// The direction of an undistorted position, of depth 1.
#[cube]
fn direction(lens: LensUniforms, a: f32, b: f32) -> Vec3 {
    if comptime!(lens.kind == LensKind::Arc) {
        let radius = f32::sqrt(a * a + b * b);
        let (kappa, omega) = lens.arc;
        let (sin, cos) = sin_cos(omega * radius);
        // on the axis sin(ω r) / r is its limit ω
        let off_axis = radius > 1e-6f32;
        let far = select(off_axis, radius, 1.0f32);
        let share = select(off_axis, sin / far, omega) / kappa;
        let along = vec3(share * a, share * b, cos);
        scale(along, 1.0f32 / f32::sqrt(dot(along, along)))
    } else {
        vec3(a, b, 1.0f32)
    }
}

/// The ray at a position in focal lengths from the principal point, camera axes, of depth 1; 0 where the lens shows nothing.
#[cube]
pub fn ray(lens: LensUniforms, x: f32, y: f32) -> Vec3 {
    let target = f32::sqrt(x * x + y * y);
    let radius = inverse_radial(lens, min(target, lens.radial_limit));
    let share = radius / max(target, 1e-20f32);
    let mut a = share * x;
    let mut b = share * y;
    let mut found = target <= lens.radial_limit;
    if comptime!(!lens.is_radial) {
        let mut step = 0u32;
        while step < TANGENTIAL_STEPS {
            let (at_x, at_y) = distort(lens, a, b);
            let (dx, dy) = (x - at_x, y - at_y);
            let j = distort_jacobian(lens, a, b);
            let inverse = 1.0f32 / (j.xx * j.yy - j.xy * j.yx);
            a += (j.yy * dx - j.xy * dy) * inverse;
            b += (j.xx * dy - j.yx * dx) * inverse;
            step += 1u32;
        }
        let (at_x, at_y) = distort(lens, a, b);
        // a fixed number of steps may end anywhere where the lens folds, so that the result is checked
        let missed = f32::abs(x - at_x) + f32::abs(y - at_y);
        found = missed < 1e-4f32 * (1.0f32 + target) && a * a + b * b <= lens.limit * lens.limit;
    }
    let along = direction(lens, a, b);
    vec3(select(found, along.x, 0.0f32), select(found, along.y, 0.0f32), select(found, along.z, 0.0f32))
}
