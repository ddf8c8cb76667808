//! The pixels that a disc can reach through a lens; the CPU's twin is [`crate::footprint::surfel::cpu::lens_reach`].

use cubecl::prelude::*;

use super::{Disc, tangents, widened};
use crate::gpu::lens::{LensUniforms, Range, angle, aside_ranges, plus, radial, radius_at, times};
use crate::gpu::rect::Rect;
use crate::gpu::vector::{dot, scale, sin_cos, vec3};
use crate::gpu::view::{CameraUniforms, pixels_within};

const PI: f32 = std::f32::consts::PI;
const LEAST_AHEAD: f32 = 0.05;
/// More than the rounding errors of angles and of relative radii.
const SLACK: f32 = 1e-4;

/// Directions from the optical axis.
#[derive(CubeType, Clone, Copy)]
#[expand(derive(Clone, Copy))]
struct Cone {
    angle: Range,
    azimuth: Range,
    /// Whether the disc is far enough from the plane across its line of sight to be bounded.
    ahead: bool,
}

/// A range of slopes as its ends, wider than rounding errors.
#[cube]
fn slopes(distance: f32, ax: f32, az: f32, bx: f32, bz: f32) -> Range {
    let (low, high) = tangents(0.0f32, distance, ax, az, bx, bz);
    Range { low: min(low, 0.0f32) * (1.0f32 + SLACK) - 1e-6f32, high: max(high, 0.0f32) * (1.0f32 + SLACK) + 1e-6f32 }
}

/// The directions in which the disc lies within `radius`, in σ.
#[cube]
fn cone(disc: Disc, radius: f32) -> Cone {
    let c = disc.centre;
    let distance = max(f32::sqrt(dot(c, c)), 1e-30f32);
    let across = f32::sqrt(c.x * c.x + c.y * c.y);
    let off_axis = across > 0.0f32;
    let beside = select(off_axis, across, 1.0f32);
    let cos_azimuth = select(off_axis, c.x / beside, 1.0f32);
    let sin_azimuth = select(off_axis, c.y / beside, 0.0f32);
    let (sin, cos) = (across / distance, c.z / distance);
    // outwards from the optical axis, around it, and along the line of sight
    let outwards = vec3(cos * cos_azimuth, cos * sin_azimuth, -sin);
    let around = vec3(-sin_azimuth, cos_azimuth, 0.0f32);
    let line = scale(c, 1.0f32 / distance);
    let a = scale(disc.tangent_u, radius * disc.scale_u);
    let b = scale(disc.tangent_v, radius * disc.scale_v);
    let (a_line, b_line) = (dot(a, line), dot(b, line));
    let ahead = distance - f32::sqrt(a_line * a_line + b_line * b_line) > LEAST_AHEAD * distance;
    let along = slopes(distance, dot(a, outwards), a_line, dot(b, outwards), b_line);
    let beside = slopes(distance, dot(a, around), a_line, dot(b, around), b_line);

    let own = angle(across, c.z);
    let widest = max(-beside.low, beside.high);
    let (away0, along0) = (sin + along.low * cos, cos - along.low * sin);
    let (away1, along1) = (sin + along.high * cos, cos - along.high * sin);
    let (thin0, thin1) = (angle(f32::abs(away0), along0), angle(f32::abs(away1), along1));
    let wide0 = angle(f32::sqrt(away0 * away0 + widest * widest), along0);
    let wide1 = angle(f32::sqrt(away1 * away1 + widest * widest), along1);
    let low = min(min(thin0, thin1), min(wide0, wide1)) - SLACK;
    let high = max(max(thin0, thin1), max(wide0, wide1)) + SLACK;
    let covers_front = own - angle(-along.low, 1.0f32) <= SLACK;
    let covers_back = own + angle(along.high, 1.0f32) >= PI - SLACK;
    let pole = covers_front || covers_back;
    let from_front = pole && (covers_front || low <= 0.5f32 * PI);
    let to_back = pole && (covers_back || high >= 0.5f32 * PI);
    let away = max(min(away0, away1), 1e-20f32);
    let azimuth = select(sin_azimuth < 0.0f32, -1.0f32, 1.0f32) * angle(f32::abs(sin_azimuth), cos_azimuth);
    Cone {
        angle: Range { low: select(from_front, 0.0f32, max(low, 0.0f32)), high: select(to_back, PI, min(high, PI)) },
        azimuth: Range {
            low: select(pole, -PI, azimuth - angle(-beside.low, away) - SLACK),
            high: select(pole, PI, azimuth + angle(beside.high, away) + SLACK),
        },
        ahead,
    }
}

/// Cosines of a range of angles from `quarter` on.
#[cube]
fn cosines(azimuth: Range, quarter: f32) -> Range {
    let (low, high) = (azimuth.low - quarter, azimuth.high - quarter);
    let (_sin_low, cos_low) = sin_cos(low);
    let (_sin_high, cos_high) = sin_cos(high);
    let top = f32::ceil((low - SLACK) / (2.0f32 * PI)) * (2.0f32 * PI);
    let bottom = f32::ceil((low - PI - SLACK) / (2.0f32 * PI)) * (2.0f32 * PI) + PI;
    Range {
        // next to an extreme a slack of the angle changes the cosine by half its square
        low: select(bottom <= high + SLACK, -1.0f32, min(cos_low, cos_high) - SLACK * SLACK),
        high: select(top <= high + SLACK, 1.0f32, max(cos_low, cos_high) + SLACK * SLACK),
    }
}

/// Radii of the positions that are moved aside.
#[cube]
fn moved_radii(lens: LensUniforms, undistorted: Range, distorted: Range) -> Range {
    if comptime!(lens.in_sequence) { distorted } else { undistorted }
}

/// Pixels that the disc can reach within `radius`, in σ; none if the radius is negative.
#[cube]
pub fn lens_reach(view: CameraUniforms, disc: Disc, radius: f32) -> Rect {
    let lens = view.lens;
    let cone = cone(disc, radius);
    let (nearest, farthest) = (radius_at(lens, cone.angle.low), radius_at(lens, cone.angle.high));
    let seen = !cone.ahead || nearest <= lens.limit * (1.0f32 + SLACK);
    let undistorted = Range { low: min(nearest, lens.limit) * (1.0f32 - SLACK), high: min(farthest, lens.limit) };
    let distorted = Range { low: radial(lens, undistorted.low), high: radial(lens, undistorted.high) };
    let (across, down) = (cosines(cone.azimuth, 0.0f32), cosines(cone.azimuth, 0.5f32 * PI));
    let (bent_x, bent_y) = (times(distorted, across), times(distorted, down));
    let moved = moved_radii(lens, undistorted, distorted);
    let (aside_x, aside_y) = aside_ranges(lens, times(moved, across), times(moved, down));
    let (x, y) = (plus(bent_x, aside_x), plus(bent_y, aside_y));
    let (x0, x1) = widened(x.low * view.fx + view.cx, x.high * view.fx + view.cx);
    let (y0, y1) = widened(y.low * view.fy + view.cy, y.high * view.fy + view.cy);
    // further than any picture, and finite: WGSL has no constant infinity
    let (x0, x1) = (select(cone.ahead, x0, -1e9f32), select(cone.ahead, x1, 1e9f32));
    let (y0, y1) = (select(cone.ahead, y0, -1e9f32), select(cone.ahead, y1, 1e9f32));
    pixels_within(view, seen && radius >= 0.0f32, x0, x1, y0, y1)
}
