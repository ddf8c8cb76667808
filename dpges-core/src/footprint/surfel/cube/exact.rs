//! A disc in pairs of f32: from its parameters to its plane, and hits for the gradients.

use cubecl::prelude::*;

use super::{Disc, Hit, Linear, Plane, bounded_scale, meeting};
use crate::gpu::exact::{
    Pair, Pairs3, add_pairs, cross_pairs, divide_pairs, dot_pairs, exactly, multiply_pairs, negated, rounded,
    two_product, two_sum,
};
use crate::gpu::lens::LensKind;
use crate::gpu::record::Record;
use crate::gpu::vector::{Quaternion, Vec3, near_unit, scale, vec3};
use crate::gpu::view::{CameraUniforms, Rests};

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
fn pairs(high: Vec3, low: Vec3) -> Pairs3 {
    Pairs3 { x: pair(high.x, low.x), y: pair(high.y, low.y), z: pair(high.z, low.z) }
}

#[cube]
fn away(position: f32, centre: f32, rest: f32, zero: u32) -> Pair {
    // the position minus the camera's centre, not R p + t, whose large terms cancel far from the origin
    let offset = two_sum(position, -centre, zero);
    two_sum(offset.high, offset.low - rest, zero)
}

/// A world direction in camera axes.
#[cube]
fn turned(view: CameraUniforms, rests: Rests, v: Pairs3) -> Pairs3 {
    let (high, low, zero) = (view.rotation, rests.rotation, view.zero);
    Pairs3 {
        x: dot_pairs(pairs(high.row0, low.row0), v, zero),
        y: dot_pairs(pairs(high.row1, low.row1), v, zero),
        z: dot_pairs(pairs(high.row2, low.row2), v, zero),
    }
}

#[cube]
pub fn exact_disc(view: CameraUniforms, rests: Rests, position: Vec3, quaternion: Quaternion) -> ExactDisc {
    let zero = view.zero;
    // a power of two is exact; a quaternion of unit length would be rounded, and axes with it
    let q = near_unit(quaternion);
    let offset = Pairs3 {
        x: away(position.x, view.centre.x, rests.centre.x, zero),
        y: away(position.y, view.centre.y, rests.centre.y, zero),
        z: away(position.z, view.centre.z, rests.centre.z, zero),
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
        // axes stay as long as they are, without roots in pairs: functions that are linear in one are divided by this
        stretch: q.w * q.w + q.x * q.x + q.y * q.y + q.z * q.z,
    }
}

#[cube]
pub fn disc_of(view: CameraUniforms, exact: ExactDisc, log_scale_u: f32, log_scale_v: f32) -> Disc {
    let centre = rounded(exact.centre);
    let inverse = 1.0f32 / exact.stretch;
    let mut is_centred = centre.z > view.near;
    if comptime!(view.lens.kind != LensKind::None) {
        is_centred = false;
    }
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

    /// [`Linear::of`]
    fn of(&self, ray: Vec3, zero: u32) -> f32 {
        let along = multiply_pairs(self.constant, exactly(ray.z), zero);
        let across = multiply_pairs(self.across, exactly(ray.x), zero);
        let down = multiply_pairs(self.down, exactly(ray.y), zero);
        let sum = add_pairs(along, add_pairs(across, down, zero), zero);
        sum.high + sum.low
    }

    fn at(&self, dx: Pair, dy: Pair, zero: u32) -> f32 {
        let (across, down) = (multiply_pairs(self.across, dx, zero), multiply_pairs(self.down, dy, zero));
        let sum = add_pairs(self.constant, add_pairs(across, down, zero), zero);
        sum.high + sum.low
    }
}

/// Focal lengths and principal point of what the linear functions of a disc are functions of.
#[derive(CubeType, Clone, Copy)]
#[expand(derive(Clone, Copy))]
struct Frame {
    fx: Pair,
    fy: Pair,
    cx: Pair,
    cy: Pair,
}

/// The camera's, px; those of the ray itself through a lens.
#[cube]
fn frame(view: CameraUniforms, rests: Rests) -> Frame {
    if comptime!(view.lens.kind == LensKind::None) {
        Frame {
            fx: pair(view.fx, rests.fx),
            fy: pair(view.fy, rests.fy),
            cx: pair(view.cx, rests.cx),
            cy: pair(view.cy, rests.cy),
        }
    } else {
        Frame { fx: exactly(1.0f32), fy: exactly(1.0f32), cx: exactly(0.0f32), cy: exactly(0.0f32) }
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
pub fn store_plane(
    view: CameraUniforms,
    rests: Rests,
    exact: ExactDisc,
    disc: Disc,
    planes: &mut [f32],
    lows: &mut [f32],
    start: usize,
) {
    let zero = view.zero;
    let one = exactly(1.0f32);
    let frame = frame(view, rests);
    let per_px = ExactScales { x: divide_pairs(one, frame.fx, zero), y: divide_pairs(one, frame.fy, zero) };
    let is_centred = disc.centred > 0.5f32;
    let depth_high = select(is_centred, exact.centre.z.high, 1.0f32);
    let depth_low = select(is_centred, exact.centre.z.low, 0.0f32);
    let depth = pair(depth_high, depth_low);
    let slope_x = divide_pairs(exact.centre.x, depth, zero);
    let slope_y = divide_pairs(exact.centre.y, depth, zero);
    let own = disc.centred;
    let anchor_x =
        add_pairs(multiply_pairs(pair(slope_x.high * own, slope_x.low * own), frame.fx, zero), frame.cx, zero);
    let anchor_y =
        add_pairs(multiply_pairs(pair(slope_y.high * own, slope_y.low * own), frame.fy, zero), frame.cy, zero);
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

/// [`Plane::hit_by`] in pairs, for the gradients. `low` holds the rounding errors of `plane`.
#[cube]
pub fn exact_hit_by(view: CameraUniforms, plane: Plane, low: Plane, sight: Vec3) -> Hit {
    let zero = view.zero;
    if comptime!(view.lens.kind == LensKind::None) {
        let dx = away(sight.x, plane.anchor_x, low.anchor_x, zero);
        let dy = away(sight.y, plane.anchor_y, low.anchor_y, zero);
        let facing = ExactLinear::load(plane.facing, low.facing).at(dx, dy, zero);
        let u = ExactLinear::load(plane.u, low.u).at(dx, dy, zero);
        let v = ExactLinear::load(plane.v, low.v).at(dx, dy, zero);
        meeting(u, v, facing, plane.distance)
    } else {
        let facing = ExactLinear::load(plane.facing, low.facing).of(sight, zero);
        let u = ExactLinear::load(plane.u, low.u).of(sight, zero);
        let v = ExactLinear::load(plane.v, low.v).of(sight, zero);
        meeting(u, v, facing, plane.distance)
    }
}
