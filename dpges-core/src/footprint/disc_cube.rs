//! One surfel seen by one camera, on the device; the CPU's twin is [`super::disc`].
//!
//! Where the CPU computes in f64, this computes with pairs of f32 ([`crate::gpu::exact`]): an edge-on
//! disc divides by a facing that is next to nothing, and its gradients by the square of it.

use cubecl::prelude::*;

use super::disc::LARGEST_LOG_SCALE as LARGEST;

use crate::gpu::exact::{
    Pair, Pairs3, add_pairs, cross_pairs, divide_pairs, dot_pairs, exactly, multiply_pairs, negated, rounded,
    two_product, two_sum,
};
use crate::gpu::vector::{
    Mat3, Quaternion, Vec3, add, apply, cross, near_unit, rotation_backward, scale, transpose, vec3,
};
use crate::gpu::view::{Rests, View, pixel_range, view_rotation};

/// Numbers of a disc's plane, in this order: anchor, u, v, facing, distance.
pub const PLANE: usize = 12;
/// Sums over the pixels of a surfel: of the gradients of u, v and facing, of the distance, of the log-scales.
pub const SUMS: usize = 12;
pub const LARGEST_LOG_SCALE: f32 = LARGEST as f32;

/// A disc in camera space; axes are longer than 1 by the same factor, squared length of the quaternion,
/// which cancels in everything but the facing.
#[derive(CubeType, Clone, Copy)]
#[expand(derive(Clone, Copy))]
pub struct ExactDisc {
    centre: Pairs3,
    tangent_u: Pairs3,
    tangent_v: Pairs3,
    normal: Pairs3,
    /// That factor.
    stretch: f32,
}

#[derive(CubeType, Clone, Copy)]
#[expand(derive(Clone, Copy))]
pub struct Disc {
    pub centre: Vec3,
    /// Axes in camera space.
    pub tangent_u: Vec3,
    pub tangent_v: Vec3,
    pub normal: Vec3,
    pub anchor_ray: Vec3,
    pub scale_u: f32,
    pub scale_v: f32,
    /// 1 where the anchor is the projected centre, else 0.
    pub centred: f32,
}

#[cube]
fn pair(high: f32, low: f32) -> Pair {
    Pair { high, low }
}

/// 2 (a b + c d)
#[cube]
fn twice(a: f32, b: f32, c: f32, d: f32, zero: u32) -> Pair {
    add_pairs(two_product(2.0f32 * a, b, zero), two_product(2.0f32 * c, d, zero), zero)
}

/// a² + b² − c² − d²
#[cube]
fn squares(a: f32, b: f32, c: f32, d: f32, zero: u32) -> Pair {
    let plus = add_pairs(two_product(a, a, zero), two_product(b, b, zero), zero);
    let minus = add_pairs(two_product(c, c, zero), two_product(d, d, zero), zero);
    add_pairs(plus, negated(minus), zero)
}

#[cube]
fn away(position: f32, centre: f32, rest: f32, zero: u32) -> Pair {
    let offset = two_sum(position, -centre, zero);
    two_sum(offset.high, offset.low - rest, zero)
}

/// A world direction in camera axes.
#[cube]
fn turned(view: View, rests: Rests, v: Pairs3) -> Pairs3 {
    let zero = view.zero;
    let row0 = Pairs3 { x: pair(view.r00, rests.r00), y: pair(view.r01, rests.r01), z: pair(view.r02, rests.r02) };
    let row1 = Pairs3 { x: pair(view.r10, rests.r10), y: pair(view.r11, rests.r11), z: pair(view.r12, rests.r12) };
    let row2 = Pairs3 { x: pair(view.r20, rests.r20), y: pair(view.r21, rests.r21), z: pair(view.r22, rests.r22) };
    Pairs3 { x: dot_pairs(row0, v, zero), y: dot_pairs(row1, v, zero), z: dot_pairs(row2, v, zero) }
}

#[cube]
pub fn exact_disc(view: View, rests: Rests, position: Vec3, quaternion: Quaternion) -> ExactDisc {
    let zero = view.zero;
    let q = near_unit(quaternion);
    let offset = Pairs3 {
        x: away(position.x, view.centre_x, rests.centre_x, zero),
        y: away(position.y, view.centre_y, rests.centre_y, zero),
        z: away(position.z, view.centre_z, rests.centre_z, zero),
    };
    let tangent_u = Pairs3 {
        x: squares(q.w, q.x, q.y, q.z, zero),
        y: twice(q.x, q.y, q.w, q.z, zero),
        z: twice(q.x, q.z, -q.w, q.y, zero),
    };
    let tangent_v = Pairs3 {
        x: twice(q.x, q.y, -q.w, q.z, zero),
        y: squares(q.w, q.y, q.x, q.z, zero),
        z: twice(q.y, q.z, q.w, q.x, zero),
    };
    let normal = Pairs3 {
        x: twice(q.x, q.z, q.w, q.y, zero),
        y: twice(q.y, q.z, -q.w, q.x, zero),
        z: squares(q.w, q.z, q.x, q.y, zero),
    };
    ExactDisc {
        centre: turned(view, rests, offset),
        tangent_u: turned(view, rests, tangent_u),
        tangent_v: turned(view, rests, tangent_v),
        normal: turned(view, rests, normal),
        stretch: q.w * q.w + q.x * q.x + q.y * q.y + q.z * q.z,
    }
}

#[cube]
pub fn disc(view: View, exact: ExactDisc, log_scale_u: f32, log_scale_v: f32) -> Disc {
    let centre = rounded(exact.centre);
    let inverse = 1.0f32 / exact.stretch;
    let is_centred = centre.z > view.near;
    let depth = select(is_centred, centre.z, 1.0f32);
    Disc {
        centre,
        tangent_u: scale(rounded(exact.tangent_u), inverse),
        tangent_v: scale(rounded(exact.tangent_v), inverse),
        normal: scale(rounded(exact.normal), inverse),
        anchor_ray: vec3(
            select(is_centred, centre.x / depth, 0.0f32),
            select(is_centred, centre.y / depth, 0.0f32),
            1.0f32,
        ),
        scale_u: f32::exp(min(log_scale_u, LARGEST_LOG_SCALE)),
        scale_v: f32::exp(min(log_scale_v, LARGEST_LOG_SCALE)),
        centred: select(is_centred, 1.0f32, 0.0f32),
    }
}

/// Row `i` of `planes` and of `rests` at number `at`: value · factor.
#[cube]
fn put(highs: &mut [f32], lows: &mut [f32], i: usize, #[comptime] at: usize, value: Pair, factor: Pair, zero: u32) {
    let product = multiply_pairs(value, factor, zero);
    highs[i * PLANE + at] = product.high;
    lows[i * PLANE + at] = product.low;
}

/// The disc's linear functions of the pixel position, row `i` of `planes`, and what rounding took from
/// them, row `i` of `lows`.
#[cube]
pub fn write_plane(
    view: View,
    rests: Rests,
    exact: ExactDisc,
    disc: Disc,
    planes: &mut [f32],
    lows: &mut [f32],
    i: usize,
) {
    let zero = view.zero;
    let one = exactly(1.0f32);
    let inverse_fx = divide_pairs(one, pair(view.fx, rests.fx), zero);
    let inverse_fy = divide_pairs(one, pair(view.fy, rests.fy), zero);
    let is_centred = disc.centred > 0.5f32;
    let depth_high = select(is_centred, exact.centre.z.high, 1.0f32);
    let depth_low = select(is_centred, exact.centre.z.low, 0.0f32);
    let depth = pair(depth_high, depth_low);
    let slope_x = divide_pairs(exact.centre.x, depth, zero);
    let slope_y = divide_pairs(exact.centre.y, depth, zero);
    let own = disc.centred;
    let anchor_x = add_pairs(
        multiply_pairs(pair(slope_x.high * own, slope_x.low * own), pair(view.fx, rests.fx), zero),
        pair(view.cx, rests.cx),
        zero,
    );
    let anchor_y = add_pairs(
        multiply_pairs(pair(slope_y.high * own, slope_y.low * own), pair(view.fy, rests.fy), zero),
        pair(view.cy, rests.cy),
        zero,
    );
    put(planes, lows, i, 0usize, anchor_x, one, zero);
    put(planes, lows, i, 1usize, anchor_y, one, zero);
    // axes are longer than 1 by the stretch: each function is linear in one of them
    let along_u = cross_pairs(exact.tangent_v, exact.centre, zero);
    let along_v = cross_pairs(exact.centre, exact.tangent_u, zero);
    let share = divide_pairs(one, exactly(exact.stretch), zero);
    let by_u = divide_pairs(share, exactly(disc.scale_u), zero);
    let by_v = divide_pairs(share, exactly(disc.scale_v), zero);
    // at the projected centre both triple products vanish
    let beside = 1.0f32 - own;
    put(planes, lows, i, 2usize, pair(along_u.z.high * beside, along_u.z.low * beside), by_u, zero);
    put(planes, lows, i, 3usize, multiply_pairs(along_u.x, inverse_fx, zero), by_u, zero);
    put(planes, lows, i, 4usize, multiply_pairs(along_u.y, inverse_fy, zero), by_u, zero);
    put(planes, lows, i, 5usize, pair(along_v.z.high * beside, along_v.z.low * beside), by_v, zero);
    put(planes, lows, i, 6usize, multiply_pairs(along_v.x, inverse_fx, zero), by_v, zero);
    put(planes, lows, i, 7usize, multiply_pairs(along_v.y, inverse_fy, zero), by_v, zero);
    let distance = dot_pairs(exact.normal, exact.centre, zero);
    let at_centre = divide_pairs(distance, depth, zero);
    let facing_high = select(is_centred, at_centre.high, exact.normal.z.high);
    let facing_low = select(is_centred, at_centre.low, exact.normal.z.low);
    put(planes, lows, i, 8usize, pair(facing_high, facing_low), share, zero);
    put(planes, lows, i, 9usize, multiply_pairs(exact.normal.x, inverse_fx, zero), share, zero);
    put(planes, lows, i, 10usize, multiply_pairs(exact.normal.y, inverse_fy, zero), share, zero);
    put(planes, lows, i, 11usize, distance, share, zero);
}

/// The linear function at `o` of `planes` and `lows`.
#[cube]
fn linear(planes: &[f32], lows: &[f32], o: usize, dx: Pair, dy: Pair, zero: u32) -> f32 {
    let constant = pair(planes[o], lows[o]);
    let across = multiply_pairs(pair(planes[o + 1], lows[o + 1]), dx, zero);
    let down = multiply_pairs(pair(planes[o + 2], lows[o + 2]), dy, zero);
    let sum = add_pairs(constant, add_pairs(across, down, zero), zero);
    sum.high + sum.low
}

/// [`hit`] to the precision of pairs, for the gradients.
#[cube]
pub fn exact_hit(planes: &[f32], lows: &[f32], o: usize, x: f32, y: f32, zero: u32) -> Hit {
    let dx = away(x, planes[o], lows[o], zero);
    let dy = away(y, planes[o + 1], lows[o + 1], zero);
    let facing = linear(planes, lows, o + 8, dx, dy, zero);
    let inverse = 1.0f32 / select(facing == 0.0f32, 1e-30f32, facing);
    let u = linear(planes, lows, o + 2, dx, dy, zero) * inverse;
    let v = linear(planes, lows, o + 5, dx, dy, zero) * inverse;
    Hit { u, v, depth: planes[o + 11] * inverse, facing, kernel: f32::exp(max(-0.5f32 * (u * u + v * v), -100.0f32)) }
}

#[derive(CubeType, Clone, Copy)]
#[expand(derive(Clone, Copy))]
pub struct Hit {
    pub u: f32,
    pub v: f32,
    pub depth: f32,
    pub facing: f32,
    pub kernel: f32,
}

/// Where the ray through the point (`x`, `y`) px meets the plane at `o` of `planes`.
#[cube]
pub fn hit(planes: &[f32], o: usize, x: f32, y: f32) -> Hit {
    let (dx, dy) = (x - planes[o], y - planes[o + 1]);
    let facing = planes[o + 8] + planes[o + 9] * dx + planes[o + 10] * dy;
    let inverse = 1.0f32 / select(facing == 0.0f32, 1e-30f32, facing);
    let u = (planes[o + 2] + planes[o + 3] * dx + planes[o + 4] * dy) * inverse;
    let v = (planes[o + 5] + planes[o + 6] * dx + planes[o + 7] * dy) * inverse;
    Hit { u, v, depth: planes[o + 11] * inverse, facing, kernel: f32::exp(max(-0.5f32 * (u * u + v * v), -100.0f32)) }
}

/// Widens what f32 may have made too narrow, px.
#[cube]
fn widened(low: f32, high: f32) -> (f32, f32) {
    let slack = 0.05f32 + 1e-4f32 * (high - low);
    (low - slack, high + slack)
}

/// Range of x / z over a disc that is wholly in front of the near plane: the two lines through the
/// eye tangent to its ellipse, from the x and z components of centre and axes.
#[cube]
fn tangents(cx: f32, cz: f32, ax: f32, az: f32, bx: f32, bz: f32) -> (f32, f32) {
    let quadratic = cz * cz - (az * az + bz * bz);
    let half_linear = cx * cz - (ax * az + bx * bz);
    let (m_ca, m_cb, m_ab) = (cx * az - cz * ax, cx * bz - cz * bx, ax * bz - az * bx);
    let root = f32::sqrt(max(m_ca * m_ca + m_cb * m_cb - m_ab * m_ab, 0.0f32));
    ((half_linear - root) / quadratic, (half_linear + root) / quadratic)
}

/// Slope x / z where the segment from one corner of the square around a disc to the next leaves the
/// near plane, or of the first corner: clipped polygons bound what they contain.
#[cube]
fn clipped(x: f32, z: f32, next_x: f32, next_z: f32, near: f32) -> (f32, f32) {
    let own = x / max(z, near);
    let share = clamp((near - z) / select(next_z == z, 1.0f32, next_z - z), 0.0f32, 1.0f32);
    let crossing = (x + (next_x - x) * share) / near;
    let front = z > near;
    let crosses = (z > near) != (next_z > near);
    let first = select(front, own, crossing);
    let second = select(crosses, crossing, first);
    let some = front || crosses;
    (select(some, min(first, second), 1e30f32), select(some, max(first, second), -1e30f32))
}

/// Range of x / z over the square around a disc, as far as it is in front of the near plane.
#[cube]
fn clipped_square(cx: f32, cz: f32, ax: f32, az: f32, bx: f32, bz: f32, near: f32) -> (f32, f32) {
    let (x0, z0) = (cx + ax + bx, cz + az + bz);
    let (x1, z1) = (cx - ax + bx, cz - az + bz);
    let (x2, z2) = (cx - ax - bx, cz - az - bz);
    let (x3, z3) = (cx + ax - bx, cz + az - bz);
    let (l0, h0) = clipped(x0, z0, x1, z1, near);
    let (l1, h1) = clipped(x1, z1, x2, z2, near);
    let (l2, h2) = clipped(x2, z2, x3, z3, near);
    let (l3, h3) = clipped(x3, z3, x0, z0, near);
    (min(min(l0, l1), min(l2, l3)), max(max(h0, h1), max(h2, h3)))
}

/// Pixels that the footprint can reach, row `i` of `rects`; a disc that crosses the near plane is
/// bounded by the square around it.
#[cube]
pub fn write_reach(view: View, disc: Disc, radius: f32, rects: &mut [u32], i: usize) {
    let c = disc.centre;
    let a = scale(disc.tangent_u, radius * disc.scale_u);
    let b = scale(disc.tangent_v, radius * disc.scale_v);
    let reach = f32::sqrt(a.z * a.z + b.z * b.z);
    let mut rect_x0 = 0u32;
    let mut rect_x1 = 0u32;
    let mut rect_y0 = 0u32;
    let mut rect_y1 = 0u32;
    if c.z + reach * 1.000_01f32 > view.near && radius >= 0.0f32 {
        // in f32 the tangents of a disc that nearly touches the near plane are not to be trusted
        let in_front = c.z - reach > view.near && c.z - reach > 0.01f32 * c.z;
        let (tx0, tx1) = tangents(c.x, c.z, a.x, a.z, b.x, b.z);
        let (ty0, ty1) = tangents(c.y, c.z, a.y, a.z, b.y, b.z);
        let (sx0, sx1) = clipped_square(c.x, c.z, a.x, a.z, b.x, b.z, view.near);
        let (sy0, sy1) = clipped_square(c.y, c.z, a.y, a.z, b.y, b.z, view.near);
        let x0 = select(in_front, tx0, sx0) * view.fx + view.cx;
        let x1 = select(in_front, tx1, sx1) * view.fx + view.cx;
        let y0 = select(in_front, ty0, sy0) * view.fy + view.cy;
        let y1 = select(in_front, ty1, sy1) * view.fy + view.cy;
        let (x0, x1) = widened(x0, x1);
        let (y0, y1) = widened(y0, y1);
        let (first_x, end_x) = pixel_range(x0, x1, view.width);
        let (first_y, end_y) = pixel_range(y0, y1, view.height);
        rect_x0 = first_x;
        rect_x1 = end_x;
        rect_y0 = first_y;
        rect_y1 = end_y;
    }
    rects[4 * i] = rect_x0;
    rects[4 * i + 1] = rect_x1;
    rects[4 * i + 2] = rect_y0;
    rects[4 * i + 3] = rect_y1;
}

/// Gradients with respect to world position and raw quaternion; those of the log-scales are sums already.
#[derive(CubeType, Clone, Copy)]
#[expand(derive(Clone, Copy))]
pub struct DiscGradient {
    pub position: Vec3,
    pub quaternion: Quaternion,
}

/// c × Σ gradient · ray; the anchor's part vanishes where the anchor is the projected centre.
#[cube]
fn centre_cross(disc: Disc, g: Vec3) -> Vec3 {
    let anchored = scale(disc.anchor_ray, g.x * (1.0f32 - disc.centred));
    cross(disc.centre, add(anchored, vec3(g.y, g.z, 0.0f32)))
}

/// Σ gradient · ray
#[cube]
fn along(disc: Disc, g: Vec3) -> Vec3 {
    add(scale(disc.anchor_ray, g.x), vec3(g.y, g.z, 0.0f32))
}

/// From the sums in row `i` to the parameters.
#[cube]
pub fn disc_backward(view: View, disc: Disc, quaternion: Quaternion, sums: &[f32], i: usize) -> DiscGradient {
    let o = i * SUMS;
    let sum_u = vec3(sums[o], sums[o + 1], sums[o + 2]);
    let sum_v = vec3(sums[o + 3], sums[o + 4], sums[o + 5]);
    let sum_facing = vec3(sums[o + 6], sums[o + 7], sums[o + 8]);
    let sum_distance = sums[o + 9];
    let grad_tangent_v = centre_cross(disc, sum_u);
    let grad_tangent_u = scale(centre_cross(disc, sum_v), -1.0f32);
    let grad_normal = add(along(disc, sum_facing), scale(disc.centre, sum_distance));
    let grad_centre = add(
        add(cross(along(disc, sum_u), disc.tangent_v), cross(disc.tangent_u, along(disc, sum_v))),
        scale(disc.normal, sum_distance),
    );
    let back = transpose(view_rotation(view));
    let columns =
        Mat3 { row0: apply(back, grad_tangent_u), row1: apply(back, grad_tangent_v), row2: apply(back, grad_normal) };
    DiscGradient { position: apply(back, grad_centre), quaternion: rotation_backward(quaternion, transpose(columns)) }
}
