//! The pixels that a disc can reach.

use cubecl::prelude::*;

use super::lens_reach::lens_reach;
use super::{Disc, tangents, widened};
use crate::gpu::lens::LensKind;
use crate::gpu::rect::Rect;
use crate::gpu::vector::scale;
use crate::gpu::view::{CameraUniforms, pixel_range};

/// Range of x / z over one side of a square, clipped by the near plane: the first corner and the point where
/// the side crosses the near plane, if there are such.
#[cube]
fn clipped(x: f32, z: f32, next_x: f32, next_z: f32, near: f32) -> (f32, f32) {
    let own = x / max(z, near);
    // a side along the near plane is crossed nowhere; its divisor must not be 0
    let share = clamp((near - z) / select(next_z == z, 1.0f32, next_z - z), 0.0f32, 1.0f32);
    let crossing = (x + (next_x - x) * share) / near;
    let front = z > near;
    let crosses = (z > near) != (next_z > near);
    let first = select(front, own, crossing);
    let second = select(crosses, crossing, first);
    let some = front || crosses;
    // a side behind the near plane changes no minimum and no maximum
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

/// Pixels that the footprint can reach within `radius`, in σ; none if the radius is negative.
#[cube]
pub fn reach(view: CameraUniforms, disc: Disc, radius: f32) -> Rect {
    if comptime!(view.lens.kind == LensKind::None) {
        pinhole_reach(view, disc, radius)
    } else {
        lens_reach(view, disc, radius)
    }
}

/// [`reach`] without a lens. The square around a disc bounds it if the disc crosses the near plane.
#[cube]
fn pinhole_reach(view: CameraUniforms, disc: Disc, radius: f32) -> Rect {
    let c = disc.centre;
    let a = scale(disc.tangent_u, radius * disc.scale_u);
    let b = scale(disc.tangent_v, radius * disc.scale_v);
    let reach = f32::sqrt(a.z * a.z + b.z * b.z);
    let mut rect = Rect { x0: 0u32, x1: 0u32, y0: 0u32, y1: 0u32 };
    // rounding must not take away a disc that just reaches across the near plane
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
