//! One surfel seen by one camera, on the device; the CPU's twin is [`super::disc`].
//!
//! The CPU computes in f64, this file with pairs of f32 ([`crate::gpu::exact`]). The facing of an edge-on
//! disc is almost 0; its hits are divided by the facing, and its gradients by the square of the facing.

use burn::backend::TensorMetadata;
use burn_cubecl::tensor::CubeTensor;
use cubecl::prelude::*;

use super::disc as on_cpu;
use crate::camera::Camera;
use crate::gpu::exact::{
    Pair, Pairs3, add_pairs, cross_pairs, divide_pairs, dot_pairs, exactly, multiply_pairs, negated, rounded,
    two_product, two_sum,
};
use crate::gpu::launch::{buffer, cube_dim, empty_f32, empty_u32, units};
use crate::gpu::record::{Record, record};
use crate::gpu::rect::{RECT, Rect};
use crate::gpu::vector::{
    Mat3, Quaternion, Vec3, add, apply, cross, near_unit, rotation_backward, row3, row4, scale, transpose, vec3,
    write3, write4,
};
use crate::gpu::view::{Rests, View, pixel_range, view_rotation};

/// Number of values in a [`Plane`].
pub const PLANE: usize = Plane::LEN;
/// Number of values in the sums over the pixels of a disc.
pub const DISC_SUMS: usize = DiscSums::LEN;
pub const MIN_FACING: f32 = on_cpu::MIN_FACING as f32;
const LARGEST_LOG_SCALE: f32 = on_cpu::LARGEST_LOG_SCALE as f32;

record! {
    /// A linear function of the pixel position.
    pub struct Linear {
        /// Value at the anchor.
        pub constant: f32,
        /// Slope per px in x and in y.
        pub across: f32,
        pub down: f32,
    }
}

#[cube]
impl Linear {
    /// Value at an offset from the anchor, px.
    fn at(&self, dx: f32, dy: f32) -> f32 {
        self.constant + self.across * dx + self.down * dy
    }
}

record! {
    /// A disc as linear functions of the pixel position relative to an anchor ([`on_cpu::Plane`]).
    pub struct Plane {
        /// px
        pub anchor_x: f32,
        pub anchor_y: f32,
        pub u: Linear,
        pub v: Linear,
        pub facing: Linear,
        pub distance: f32,
    }
}

#[cube]
impl Plane {
    /// Where the ray through the point (`x`, `y`) px meets the plane.
    pub fn hit(&self, x: f32, y: f32) -> Hit {
        let (dx, dy) = (x - self.anchor_x, y - self.anchor_y);
        meeting(self.u.at(dx, dy), self.v.at(dx, dy), self.facing.at(dx, dy), self.distance)
    }
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

/// The hit at a pixel with these values of the linear functions.
#[cube]
fn meeting(u: f32, v: f32, facing: f32, distance: f32) -> Hit {
    let inverse = 1.0f32 / select(facing == 0.0f32, 1e-30f32, facing);
    let (u, v) = (u * inverse, v * inverse);
    Hit { u, v, depth: distance * inverse, facing, kernel: f32::exp(max(-0.5f32 * (u * u + v * v), -100.0f32)) }
}

record! {
    /// Gradients of the linear functions of a surfel, summed over its pixels.
    struct DiscSums {
        /// Of r·(t_v × c): at the anchor, times offset in x, times offset in y (offsets in units of the ray).
        pub u: Vec3,
        pub v: Vec3,
        pub facing: Vec3,
        pub distance: f32,
        pub log_scale_u: f32,
        pub log_scale_v: f32,
    }
}

/// A pixel of a surfel in the backward pass.
#[derive(CubeType, Clone, Copy)]
#[expand(derive(Clone, Copy))]
pub struct DiscPixel {
    pub hit: Hit,
    /// Offset from the anchor, in units of the ray.
    pub across: f32,
    pub down: f32,
    /// Along t_u and t_v, world units.
    pub scale_u: f32,
    pub scale_v: f32,
    /// Gradients with respect to the exponent of the kernel and to the depth.
    pub power: f32,
    pub grad_depth: f32,
}

/// Adds a pixel to the first [`DISC_SUMS`] of a unit's sums: what the gradient of the exponent, that of the
/// depth, or both contribute. Returns the gradients with respect to r·(t_v × c), r·(c × t_u) and the distance.
#[cube]
pub fn add_disc_sums(
    own: &mut Array<f32>,
    pixel: DiscPixel,
    #[comptime] of_kernel: bool,
    #[comptime] of_depth: bool,
) -> Vec3 {
    let hit = pixel.hit;
    let mut towards_u = 0.0f32;
    let mut towards_v = 0.0f32;
    let mut towards_distance = 0.0f32;
    let mut along = 0.0f32;
    if comptime!(of_kernel) {
        let (grad_u, grad_v) = (-pixel.power * hit.u, -pixel.power * hit.v);
        towards_u = grad_u / (hit.facing * pixel.scale_u);
        towards_v = grad_v / (hit.facing * pixel.scale_v);
        along = grad_u * hit.u + grad_v * hit.v;
        own[0] += towards_u;
        own[1] += towards_u * pixel.across;
        own[2] += towards_u * pixel.down;
        own[3] += towards_v;
        own[4] += towards_v * pixel.across;
        own[5] += towards_v * pixel.down;
        own[10] -= grad_u * hit.u;
        own[11] -= grad_v * hit.v;
    }
    if comptime!(of_depth) {
        along += pixel.grad_depth * hit.depth;
        towards_distance = pixel.grad_depth / hit.facing;
        own[9] += towards_distance;
    }
    let towards_facing = -along / hit.facing;
    own[6] += towards_facing;
    own[7] += towards_facing * pixel.across;
    own[8] += towards_facing * pixel.down;
    vec3(towards_u, towards_v, towards_distance)
}

/// Scale in world units, bounded so that its square is finite.
#[cube]
pub fn bounded_scale(log_scale: f32) -> f32 {
    f32::exp(min(log_scale, LARGEST_LOG_SCALE))
}

/// A disc in camera space. All axes have the same length: the squared length of the quaternion.
#[derive(CubeType, Clone, Copy)]
#[expand(derive(Clone, Copy))]
pub struct ExactDisc {
    centre: Pairs3,
    tangent_u: Pairs3,
    tangent_v: Pairs3,
    normal: Pairs3,
    /// Length of the axes.
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
pub fn disc_of(view: View, exact: ExactDisc, log_scale_u: f32, log_scale_v: f32) -> Disc {
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
        scale_u: bounded_scale(log_scale_u),
        scale_v: bounded_scale(log_scale_v),
        centred: select(is_centred, 1.0f32, 0.0f32),
    }
}

/// A [`Linear`] function in pairs.
#[derive(CubeType, Clone, Copy)]
#[expand(derive(Clone, Copy))]
struct ExactLinear {
    constant: Pair,
    across: Pair,
    down: Pair,
}

#[cube]
impl ExactLinear {
    fn load(highs: Linear, lows: Linear) -> ExactLinear {
        ExactLinear {
            constant: pair(highs.constant, lows.constant),
            across: pair(highs.across, lows.across),
            down: pair(highs.down, lows.down),
        }
    }

    /// `factor` · (constant, slope · per_px_x, slope · per_px_y)
    fn new(constant: Pair, slope: Pairs3, per_px: ExactScales, factor: Pair, zero: u32) -> ExactLinear {
        ExactLinear {
            constant: multiply_pairs(constant, factor, zero),
            across: multiply_pairs(multiply_pairs(slope.x, per_px.x, zero), factor, zero),
            down: multiply_pairs(multiply_pairs(slope.y, per_px.y, zero), factor, zero),
        }
    }

    fn highs(&self) -> Linear {
        Linear { constant: self.constant.high, across: self.across.high, down: self.down.high }
    }

    fn lows(&self) -> Linear {
        Linear { constant: self.constant.low, across: self.across.low, down: self.down.low }
    }

    fn at(&self, dx: Pair, dy: Pair, zero: u32) -> f32 {
        let (across, down) = (multiply_pairs(self.across, dx, zero), multiply_pairs(self.down, dy, zero));
        let sum = add_pairs(self.constant, add_pairs(across, down, zero), zero);
        sum.high + sum.low
    }
}

/// Reciprocal focal lengths.
#[derive(CubeType, Clone, Copy)]
#[expand(derive(Clone, Copy))]
struct ExactScales {
    x: Pair,
    y: Pair,
}

/// Writes the linear functions of a disc to `planes` and their rounding errors to `lows`, from `start` on.
#[cube]
fn store_plane(
    view: View,
    rests: Rests,
    exact: ExactDisc,
    disc: Disc,
    planes: &mut [f32],
    lows: &mut [f32],
    start: usize,
) {
    let zero = view.zero;
    let one = exactly(1.0f32);
    let per_px = ExactScales {
        x: divide_pairs(one, pair(view.fx, rests.fx), zero),
        y: divide_pairs(one, pair(view.fy, rests.fy), zero),
    };
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
    // every function is linear in one axis, so it is divided once by the length of the axes
    let along_u = cross_pairs(exact.tangent_v, exact.centre, zero);
    let along_v = cross_pairs(exact.centre, exact.tangent_u, zero);
    let share = divide_pairs(one, exactly(exact.stretch), zero);
    let by_u = divide_pairs(share, exactly(disc.scale_u), zero);
    let by_v = divide_pairs(share, exactly(disc.scale_v), zero);
    // both triple products vanish at the projected centre
    let beside = 1.0f32 - own;
    let of_u = pair(along_u.z.high * beside, along_u.z.low * beside);
    let of_v = pair(along_v.z.high * beside, along_v.z.low * beside);
    let product = dot_pairs(exact.normal, exact.centre, zero);
    let at_centre = divide_pairs(product, depth, zero);
    let facing_high = select(is_centred, at_centre.high, exact.normal.z.high);
    let facing_low = select(is_centred, at_centre.low, exact.normal.z.low);
    let u = ExactLinear::new(of_u, along_u, per_px, by_u, zero);
    let v = ExactLinear::new(of_v, along_v, per_px, by_v, zero);
    let facing = ExactLinear::new(pair(facing_high, facing_low), exact.normal, per_px, share, zero);
    let distance = multiply_pairs(product, share, zero);
    let high = Plane {
        anchor_x: anchor_x.high,
        anchor_y: anchor_y.high,
        u: u.highs(),
        v: v.highs(),
        facing: facing.highs(),
        distance: distance.high,
    };
    let low = Plane {
        anchor_x: anchor_x.low,
        anchor_y: anchor_y.low,
        u: u.lows(),
        v: v.lows(),
        facing: facing.lows(),
        distance: distance.low,
    };
    Plane::store(high, planes, start);
    Plane::store(low, lows, start);
}

/// [`Plane::hit`] in pairs, for the gradients. `low` holds the rounding errors of `plane`.
#[cube]
pub fn exact_hit(plane: Plane, low: Plane, x: f32, y: f32, zero: u32) -> Hit {
    let dx = away(x, plane.anchor_x, low.anchor_x, zero);
    let dy = away(y, plane.anchor_y, low.anchor_y, zero);
    let facing = ExactLinear::load(plane.facing, low.facing).at(dx, dy, zero);
    let u = ExactLinear::load(plane.u, low.u).at(dx, dy, zero);
    let v = ExactLinear::load(plane.v, low.v).at(dx, dy, zero);
    meeting(u, v, facing, plane.distance)
}

/// Widens a range by more than the rounding errors of f32, px.
#[cube]
fn widened(low: f32, high: f32) -> (f32, f32) {
    let slack = 0.05f32 + 1e-4f32 * (high - low);
    (low - slack, high + slack)
}

/// Range of x / z over a disc in front of the near plane, from the x and z components of its centre and
/// axes. The ends are the two lines through the eye that are tangent to its ellipse.
#[cube]
fn tangents(cx: f32, cz: f32, ax: f32, az: f32, bx: f32, bz: f32) -> (f32, f32) {
    let quadratic = cz * cz - (az * az + bz * bz);
    let half_linear = cx * cz - (ax * az + bx * bz);
    let (m_ca, m_cb, m_ab) = (cx * az - cz * ax, cx * bz - cz * bx, ax * bz - az * bx);
    let root = f32::sqrt(max(m_ca * m_ca + m_cb * m_cb - m_ab * m_ab, 0.0f32));
    ((half_linear - root) / quadratic, (half_linear + root) / quadratic)
}

/// Range of x / z over one side of a square, clipped by the near plane: the first corner and the point where
/// the side crosses the near plane, if there are such.
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

/// Range of x / z over the part of the square around a disc that lies in front of the near plane.
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

/// Pixels that the footprint can reach within `radius`, in σ; none if the radius is negative. The square
/// around a disc bounds it if the disc crosses the near plane.
#[cube]
pub fn reach(view: View, disc: Disc, radius: f32) -> Rect {
    let c = disc.centre;
    let a = scale(disc.tangent_u, radius * disc.scale_u);
    let b = scale(disc.tangent_v, radius * disc.scale_v);
    let reach = f32::sqrt(a.z * a.z + b.z * b.z);
    let mut rect = Rect { x0: 0u32, x1: 0u32, y0: 0u32, y1: 0u32 };
    if c.z + reach * 1.000_01f32 > view.near && radius >= 0.0f32 {
        // near the near plane, rounding errors make the tangents useless
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
        rect.x0 = first_x;
        rect.x1 = end_x;
        rect.y0 = first_y;
        rect.y1 = end_y;
    }
    rect
}

/// Gradients with respect to world position and raw quaternion. [`DiscSums`] has those of the log-scales.
#[derive(CubeType, Clone, Copy)]
#[expand(derive(Clone, Copy))]
struct DiscGradient {
    position: Vec3,
    quaternion: Quaternion,
}

/// c × Σ gradient · ray. The term of the anchor is 0 if the anchor is the projected centre.
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

/// Gradients with respect to the parameters, from the sums.
#[cube]
fn disc_backward(view: View, disc: Disc, quaternion: Quaternion, sums: DiscSums) -> DiscGradient {
    let grad_tangent_v = centre_cross(disc, sums.u);
    let grad_tangent_u = scale(centre_cross(disc, sums.v), -1.0f32);
    let grad_normal = add(along(disc, sums.facing), scale(disc.centre, sums.distance));
    let grad_centre = add(
        add(cross(along(disc, sums.u), disc.tangent_v), cross(disc.tangent_u, along(disc, sums.v))),
        scale(disc.normal, sums.distance),
    );
    let back = transpose(view_rotation(view));
    let columns =
        Mat3 { row0: apply(back, grad_tangent_u), row1: apply(back, grad_tangent_v), row2: apply(back, grad_normal) };
    DiscGradient { position: apply(back, grad_centre), quaternion: rotation_backward(quaternion, transpose(columns)) }
}

#[cube(launch)]
fn planes_kernel(
    positions: &[f32],
    quaternions: &[f32],
    log_scales: &[f32],
    order: &[u32],
    planes: &mut [f32],
    lows: &mut [f32],
    rects: &mut [u32],
    view: View,
    rests: Rests,
    radius: f32,
    count: u32,
    #[comptime] scales: usize,
    #[comptime] ordered: bool,
    #[comptime] bounded: bool,
) {
    let rank = ABSOLUTE_POS;
    if rank >= count as usize {
        terminate!();
    }
    let mut i = rank;
    if comptime!(ordered) {
        i = order[rank] as usize;
    }
    let exact = exact_disc(view, rests, row3(positions, i), row4(quaternions, i));
    let disc = disc_of(view, exact, log_scales[scales * i], log_scales[scales * i + 1]);
    store_plane(view, rests, exact, disc, planes, lows, rank * PLANE);
    if comptime!(bounded) {
        reach(view, disc, radius).store(rects, rank);
    }
}

#[cube(launch)]
fn disc_backward_kernel(
    positions: &[f32],
    quaternions: &[f32],
    log_scales: &[f32],
    sums: &[f32],
    grad_positions: &mut [f32],
    grad_quaternions: &mut [f32],
    grad_log_scales: &mut [f32],
    view: View,
    rests: Rests,
    count: u32,
    #[comptime] scales: usize,
) {
    let i = ABSOLUTE_POS;
    if i >= count as usize {
        terminate!();
    }
    let quaternion = row4(quaternions, i);
    let exact = exact_disc(view, rests, row3(positions, i), quaternion);
    let disc = disc_of(view, exact, log_scales[scales * i], log_scales[scales * i + 1]);
    let sums = DiscSums::load(sums, i * DISC_SUMS);
    let gradient = disc_backward(view, disc, quaternion, sums);
    write3(grad_positions, i, gradient.position);
    write4(grad_quaternions, i, gradient.quaternion);
    grad_log_scales[scales * i] = sums.log_scale_u;
    grad_log_scales[scales * i + 1] = sums.log_scale_v;
    if comptime!(scales > 2) {
        grad_log_scales[scales * i + 2] = 0.0f32;
    }
}

/// Discs, or the gradients with respect to them.
pub struct DiscTensors<'a> {
    /// [N, 3]
    pub positions: &'a CubeTensor,
    /// [N, 4]
    pub quaternions: &'a CubeTensor,
    /// [N, 2], or [N, 3] with an unused third column
    pub log_scales: &'a CubeTensor,
}

/// The part of the discs that does not depend on the pixel.
pub struct Planes {
    /// [N, [`PLANE`]] planes and their rounding errors
    pub planes: CubeTensor,
    pub lows: CubeTensor,
    /// [N, [`RECT`]] pixel rectangles; uninitialised without a radius
    pub rects: CubeTensor,
}

/// Planes of `discs`, and the pixels that they reach within `radius`, in σ ([`reach`]). Row i is disc i, or disc
/// `order[i]` with an `order` [N].
pub fn planes(discs: &DiscTensors, order: Option<&CubeTensor>, radius: Option<f32>, camera: &Camera) -> Planes {
    let like = discs.positions;
    let count = like.shape()[0];
    let (planes, lows) = (empty_f32(like, [count, PLANE]), empty_f32(like, [count, PLANE]));
    let rects = empty_u32(like, [count, RECT]);
    planes_kernel::launch(
        &like.client.clone(),
        units(count),
        cube_dim(),
        buffer(discs.positions),
        buffer(discs.quaternions),
        buffer(discs.log_scales),
        buffer(order.unwrap_or(&empty_u32(like, [1]))),
        buffer(&planes),
        buffer(&lows),
        buffer(&rects),
        View::launch(camera),
        Rests::launch(camera),
        radius.unwrap_or(-1.0),
        count as u32,
        discs.log_scales.shape()[1],
        order.is_some(),
        radius.is_some(),
    );
    Planes { planes, lows, rects }
}

/// Writes the gradients with respect to `discs` into `out`, from the `sums` [N, [`DISC_SUMS`]].
pub fn backward(discs: &DiscTensors, sums: &CubeTensor, camera: &Camera, out: &DiscTensors) {
    let count = sums.shape()[0];
    disc_backward_kernel::launch(
        &sums.client.clone(),
        units(count),
        cube_dim(),
        buffer(discs.positions),
        buffer(discs.quaternions),
        buffer(discs.log_scales),
        buffer(sums),
        buffer(out.positions),
        buffer(out.quaternions),
        buffer(out.log_scales),
        View::launch(camera),
        Rests::launch(camera),
        count as u32,
        discs.log_scales.shape()[1],
    );
}
