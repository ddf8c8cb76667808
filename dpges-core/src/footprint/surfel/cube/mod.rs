//! One surfel seen by one camera, on the device; the CPU's twin is [`super::cpu`].
//!
//! The CPU computes in f64, this room with pairs of f32 ([`crate::gpu::exact`]). The facing of an edge-on
//! disc is almost 0; its hits are divided by the facing, and its gradients by the square of the facing.

mod bounds;
mod exact;
mod lens_reach;

use burn::backend::TensorMetadata;
use burn_cubecl::tensor::CubeTensor;
use cubecl::prelude::*;

pub use self::bounds::reach;
use self::exact::store_plane;
pub use self::exact::{disc_of, exact_disc, exact_hit_by};
use super::cpu as on_cpu;
use crate::camera::Camera;
use crate::gpu::launch::{buffer, cube_dim, empty_f32, empty_u32, units};
use crate::gpu::lens::LensKind;
use crate::gpu::record::{Record, record};
use crate::gpu::rect::RECT;
use crate::gpu::vector::{
    Mat3, Quaternion, Vec3, add, apply, cross, rotation_backward, row3, row4, scale, transpose, vec3, write3, write4,
};
use crate::gpu::view::{CameraUniforms, Rests};

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

    /// Value for a ray through a lens: its constant is the slope in z.
    fn of(&self, ray: Vec3) -> f32 {
        self.constant * ray.z + self.across * ray.x + self.down * ray.y
    }
}

record! {
    /// A disc as linear functions of the pixel position relative to an anchor, or of the ray through a lens
    /// ([`on_cpu::Plane`]).
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

    /// Where it is met at a pixel with this [`sight`](crate::gpu::view::sight).
    pub fn hit_by(&self, view: CameraUniforms, sight: Vec3) -> Hit {
        if comptime!(view.lens.kind == LensKind::None) {
            self.hit(sight.x, sight.y)
        } else {
            meeting(self.u.of(sight), self.v.of(sight), self.facing.of(sight), self.distance)
        }
    }

    /// Factors of the linear functions at a pixel: constant, across, down.
    pub fn shares(&self, view: CameraUniforms, sight: Vec3) -> Vec3 {
        if comptime!(view.lens.kind == LensKind::None) {
            vec3(1.0f32, (sight.x - self.anchor_x) / view.fx, (sight.y - self.anchor_y) / view.fy)
        } else {
            vec3(sight.z, sight.x, sight.y)
        }
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
    // a hit far away in place of a division by 0; kernels drop it by `MIN_FACING`
    let inverse = 1.0f32 / select(facing == 0.0f32, 1e-30f32, facing);
    let (u, v) = (u * inverse, v * inverse);
    // bounded, since devices may assume that no number is infinite
    Hit { u, v, depth: distance * inverse, facing, kernel: f32::exp(max(-0.5f32 * (u * u + v * v), -100.0f32)) }
}

record! {
    /// Gradients of the linear functions of a surfel, summed over its pixels.
    struct DiscSums {
        /// For r·(t_v × c): at the anchor, times offset in x, times offset in y (offsets in units of the ray).
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

/// Adds a pixel to the first [`DISC_SUMS`] of a unit's sums: what the gradient of the exponent, that of the depth, or both
/// contribute. The constant of the linear functions counts `constant` times: 1, or z of the ray through a lens. Returns the
/// gradients with respect to r·(t_v × c), r·(c × t_u) and the distance.
#[cube]
pub fn add_sums(
    own: &mut Array<f32>,
    pixel: DiscPixel,
    constant: f32,
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
        own[0] += towards_u * constant;
        own[1] += towards_u * pixel.across;
        own[2] += towards_u * pixel.down;
        own[3] += towards_v * constant;
        own[4] += towards_v * pixel.across;
        own[5] += towards_v * pixel.down;
        own[10] -= grad_u * hit.u;
        own[11] -= grad_v * hit.v;
    }
    if comptime!(of_depth) {
        // depth = distance / facing, so that both terms go to the facing in one sum
        along += pixel.grad_depth * hit.depth;
        towards_distance = pixel.grad_depth / hit.facing;
        own[9] += towards_distance;
    }
    let towards_facing = -along / hit.facing;
    own[6] += towards_facing * constant;
    own[7] += towards_facing * pixel.across;
    own[8] += towards_facing * pixel.down;
    vec3(towards_u, towards_v, towards_distance)
}

/// Scale in world units, bounded so that its square is finite.
#[cube]
pub fn bounded_scale(log_scale: f32) -> f32 {
    f32::exp(min(log_scale, LARGEST_LOG_SCALE))
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

/// Widens a range by more than the rounding errors of f32, px.
#[cube]
pub fn widened(low: f32, high: f32) -> (f32, f32) {
    // relative, too: tangents of a wide disc lose digits in proportion
    let slack = 0.05f32 + 1e-4f32 * (high - low);
    (low - slack, high + slack)
}

/// Range of x / z over a disc in front of the near plane, from the x and z components of its centre and
/// axes. The ends are the two lines through the eye that are tangent to its ellipse.
#[cube]
pub fn tangents(cx: f32, cz: f32, ax: f32, az: f32, bx: f32, bz: f32) -> (f32, f32) {
    let quadratic = cz * cz - (az * az + bz * bz);
    let half_linear = cx * cz - (ax * az + bx * bz);
    let (m_ca, m_cb, m_ab) = (cx * az - cz * ax, cx * bz - cz * bx, ax * bz - az * bx);
    let root = f32::sqrt(max(m_ca * m_ca + m_cb * m_cb - m_ab * m_ab, 0.0f32));
    ((half_linear - root) / quadratic, (half_linear + root) / quadratic)
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
    // the product of a centre with its own ray is 0, and in f32 would be rounding alone
    let anchored = scale(disc.anchor_ray, g.x * (1.0f32 - disc.centred));
    cross(disc.centre, add(anchored, vec3(g.y, g.z, 0.0f32)))
}

/// Σ gradient · ray
#[cube]
fn along(disc: Disc, g: Vec3) -> Vec3 {
    add(scale(disc.anchor_ray, g.x), vec3(g.y, g.z, 0.0f32))
}

#[cube]
fn disc_backward(view: CameraUniforms, disc: Disc, quaternion: Quaternion, sums: DiscSums) -> DiscGradient {
    let grad_tangent_v = centre_cross(disc, sums.u);
    let grad_tangent_u = scale(centre_cross(disc, sums.v), -1.0f32);
    let grad_normal = add(along(disc, sums.facing), scale(disc.centre, sums.distance));
    let grad_centre = add(
        add(cross(along(disc, sums.u), disc.tangent_v), cross(disc.tangent_u, along(disc, sums.v))),
        scale(disc.normal, sums.distance),
    );
    let back = transpose(view.rotation);
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
    view: CameraUniforms,
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
    view: CameraUniforms,
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
        // a new buffer has any contents
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
        CameraUniforms::launch(camera),
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
        CameraUniforms::launch(camera),
        Rests::launch(camera),
        count as u32,
        discs.log_scales.shape()[1],
    );
}
