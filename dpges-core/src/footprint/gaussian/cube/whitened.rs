//! A Gaussian that rays meet in the frame in which it is a sphere (HTGS), on the device; the CPU's twin, which has the
//! formulas, is [`super::super::cpu::whitened`].

use burn::backend::TensorMetadata;
use burn_cubecl::CubeBackend;
use burn_cubecl::tensor::CubeTensor;
use cubecl::prelude::*;

use super::super::cpu::whitened;
use super::super::tensors::GaussianTensors;
use super::gradients::SplatGradient;
use super::{CUTOFF_F32, GaussianBuffers, INVERSE_CUTOFF, parts, store_gradient};
use crate::camera::Camera;
use crate::gpu::launch::{buffer, cube_dim, empty_f32, empty_u32, units};
use crate::gpu::record::{Record, record};
use crate::gpu::rect::{RECT, Rect};
use crate::gpu::vector::{
    Mat3, Vec3, add, apply, cross, dot, rotation, rotation_backward, row3, row4, scale, times, transpose, vec3,
};
use crate::gpu::view::{CameraUniforms, camera_axes, pixels_within, to_camera};

const MIN_SQUARED_DIRECTION: f32 = whitened::MIN_SQUARED_DIRECTION as f32;
pub const WHITENED_SUMS: usize = whitened::SUMS;

record! {
    /// A Gaussian seen by a camera; no fragment of it exists unless `strength` is above 0.
    pub struct Whitened {
        /// Projected centre, px.
        pub mean_x: f32,
        pub mean_y: f32,
        pub a: Vec3,
        pub b: Vec3,
        pub z: Vec3,
        /// Depth of the centre, world units.
        pub depth: f32,
        /// Depth over the largest scale.
        pub distance: f32,
        pub strength: f32,
    }
}

/// Numbers of a [`Whitened`].
pub const WHITENED: usize = Whitened::LEN;

#[derive(CubeType, Clone, Copy)]
#[expand(derive(Clone, Copy))]
struct Ray {
    x: f32,
    y: f32,
    moment: Vec3,
    direction: Vec3,
    inverse: f32,
}

/// Gradients of a pixel, as in the twin.
#[derive(CubeType, Clone, Copy)]
#[expand(derive(Clone, Copy))]
pub struct RayGrad {
    pub a: Vec3,
    pub b: Vec3,
    pub z: Vec3,
    pub distance: f32,
    pub x: f32,
    pub y: f32,
    pub depth: f32,
}

#[cube]
fn minus(a: Vec3, b: Vec3) -> Vec3 {
    vec3(a.x - b.x, a.y - b.y, a.z - b.z)
}

#[cube]
impl Whitened {
    fn ray(&self, view: CameraUniforms, x: f32, y: f32) -> Ray {
        let (x, y) = ((x - self.mean_x) / view.fx, (y - self.mean_y) / view.fy);
        let moment = minus(scale(self.b, x), scale(self.a, y));
        let direction = cross(minus(self.a, scale(self.z, x)), minus(self.b, scale(self.z, y)));
        let inverse = 1.0f32 / max(dot(direction, direction), MIN_SQUARED_DIRECTION);
        Ray { x, y, moment, direction, inverse }
    }

    /// α before it is capped at the point (`x`, `y`) px, 0 below the cutoff, and the depth at which it is largest along the
    /// ray.
    pub fn fragment(&self, view: CameraUniforms, x: f32, y: f32) -> (f32, f32) {
        let ray = self.ray(view, x, y);
        let squared = self.distance * self.distance * dot(ray.moment, ray.moment) * ray.inverse;
        // bounded, since devices may assume that no number is infinite; e⁻¹⁰⁰ is far below the cutoff
        let alpha = self.strength * f32::exp(max(-0.5f32 * squared, -100.0f32));
        let along = dot(self.z, cross(ray.direction, ray.moment)) * ray.inverse;
        let exists = alpha >= CUTOFF_F32;
        (select(exists, alpha, 0.0f32), select(exists, self.depth * (1.0f32 - along), self.depth))
    }

    /// Gradients at the point (`x`, `y`) px, from those of the exponent and of the depth of the fragment there.
    pub fn pixel_backward(&self, view: CameraUniforms, x: f32, y: f32, power: f32, grad_depth: f32) -> RayGrad {
        let ray = self.ray(view, x, y);
        let squared = self.distance * self.distance;
        let deviations = squared * dot(ray.moment, ray.moment) * ray.inverse;
        let ahead = cross(ray.direction, ray.moment);
        let along = dot(self.z, ahead) * ray.inverse;
        let grad_along = -self.depth * grad_depth * ray.inverse;
        let grad_moment =
            add(scale(ray.moment, -power * squared * ray.inverse), scale(cross(self.z, ray.direction), grad_along));
        let grad_direction = add(
            scale(ray.direction, power * deviations * ray.inverse - 2.0f32 * grad_along * along),
            scale(cross(ray.moment, self.z), grad_along),
        );
        let plane_a = minus(self.a, scale(self.z, ray.x));
        let plane_b = minus(self.b, scale(self.z, ray.y));
        let grad_a = cross(plane_b, grad_direction);
        let grad_b = cross(grad_direction, plane_a);
        RayGrad {
            a: minus(grad_a, scale(grad_moment, ray.y)),
            b: add(grad_b, scale(grad_moment, ray.x)),
            z: minus(scale(ahead, grad_along), add(scale(grad_a, ray.x), scale(grad_b, ray.y))),
            distance: -power * deviations,
            x: dot(self.b, grad_moment) - dot(self.z, grad_a),
            y: -dot(self.a, grad_moment) - dot(self.z, grad_b),
            depth: grad_depth * (1.0f32 - along),
        }
    }

    /// Gradient with respect to the centre in camera axes, times its depth.
    pub fn towards(&self, grad: RayGrad, view: CameraUniforms) -> Vec3 {
        let x = -dot(self.z, grad.a) - grad.x;
        let y = -dot(self.z, grad.b) - grad.y;
        let slope_x = (self.mean_x - view.cx) / view.fx;
        let slope_y = (self.mean_y - view.cy) / view.fy;
        vec3(x, y, grad.distance + self.depth * grad.depth - slope_x * x - slope_y * y)
    }
}

/// Adds what a pixel says to the sums of a Gaussian.
#[cube]
pub fn add_whitened_sums(own: &mut Array<f32>, grad: RayGrad, power: f32) {
    own[0] += grad.a.x;
    own[1] += grad.a.y;
    own[2] += grad.a.z;
    own[3] += grad.b.x;
    own[4] += grad.b.y;
    own[5] += grad.b.z;
    own[6] += grad.z.x;
    own[7] += grad.z.y;
    own[8] += grad.z.z;
    own[9] += grad.distance;
    own[10] += grad.x;
    own[11] += grad.y;
    own[12] += power;
}

#[cube]
fn largest(values: Vec3) -> f32 {
    max(values.x, max(values.y, values.z))
}

/// Scales over the largest.
#[cube]
fn relative(log_scales: Vec3) -> Vec3 {
    let most = largest(log_scales);
    vec3(f32::exp(log_scales.x - most), f32::exp(log_scales.y - most), f32::exp(log_scales.z - most))
}

/// Offsets, over the focal length, at which a plane through the camera touches the ellipsoid: the middle and half of what lies
/// between them.
#[cube]
fn touched(plane: Vec3, z: Vec3, squared_radius: f32, denominator: f32) -> (f32, f32) {
    let middle = -squared_radius * dot(plane, z) / denominator;
    (middle, f32::sqrt(middle * middle + squared_radius * dot(plane, plane) / denominator))
}

/// Scaled axes in camera axes, by rows, over the largest scale.
#[cube]
fn rows(axes: Mat3, relative: Vec3) -> Mat3 {
    let rows = transpose(axes);
    Mat3 { row0: times(rows.row0, relative), row1: times(rows.row1, relative), row2: times(rows.row2, relative) }
}

/// A Gaussian seen by a camera, and the pixels that it can reach.
#[cube]
fn whitened_of(view: CameraUniforms, axes: Mat3, log_scales: Vec3, centre: Vec3, opacity: f32) -> (Whitened, Rect) {
    let strength = max(opacity, 0.0f32);
    let rows = rows(axes, relative(log_scales));
    let size = f32::exp(largest(log_scales));
    let squared_radius = 2.0f32 * f32::ln(max(strength * INVERSE_CUTOFF, 1.0f32)) * 1.001f32 + 1e-4f32;
    // not the wider radius of the box: whether a Gaussian is drawn at all should be as on the CPU
    let exact_radius = 2.0f32 * f32::ln(max(strength * INVERSE_CUTOFF, 1.0f32)) * 1.000_01f32;
    let z = rows.row2;
    let reach = size * f32::sqrt(exact_radius * dot(z, z));
    let visible = strength >= CUTOFF_F32 && centre.z - reach > view.near && size < 3e38f32 && size > 0.0f32;
    let depth = select(visible, centre.z, 1.0f32);
    let (slope_x, slope_y) = (centre.x / depth, centre.y / depth);
    let a = minus(rows.row0, scale(z, slope_x));
    let b = minus(rows.row1, scale(z, slope_y));
    let distance = depth / select(visible, size, 1.0f32);
    let (mean_x, mean_y) = (view.fx * slope_x + view.cx, view.fy * slope_y + view.cy);
    // a little more than the ellipsoid may reach the camera: then its box is everything
    let denominator = distance * distance - squared_radius * dot(z, z);
    let bounded = denominator > 0.0f32;
    let divisor = select(bounded, denominator, 1.0f32);
    let (middle_x, half_x) = touched(a, z, squared_radius, divisor);
    let (middle_y, half_y) = touched(b, z, squared_radius, divisor);
    let wide = f32::cast_from(view.width + view.height) * 4.0f32;
    let slack = 0.01f32;
    let across = select(bounded, view.fx * half_x + slack, wide);
    let down = select(bounded, view.fy * half_y + slack, wide);
    let x = select(bounded, mean_x + view.fx * middle_x, 0.0f32);
    let y = select(bounded, mean_y + view.fy * middle_y, 0.0f32);
    let whitened = Whitened { mean_x, mean_y, a, b, z, depth, distance, strength: select(visible, strength, 0.0f32) };
    (whitened, pixels_within(view, visible, x - across, x + across, y - down, y + down))
}

#[cube]
fn seen(gaussians: &GaussianBuffers, view: CameraUniforms, i: usize) -> (Whitened, Rect) {
    let axes = camera_axes(view, rotation(row4(&gaussians.quaternions, i)));
    let centre = to_camera(view, row3(&gaussians.positions, i));
    whitened_of(view, axes, row3(&gaussians.log_scales, i), centre, gaussians.opacities[i])
}

#[cube(launch)]
fn whitened_kernel(
    gaussians: &GaussianBuffers,
    order: &[u32],
    shapes: &mut [f32],
    rects: &mut [u32],
    view: CameraUniforms,
    count: u32,
) {
    let rank = ABSOLUTE_POS;
    if rank >= count as usize {
        terminate!();
    }
    let (whitened, rect) = seen(gaussians, view, order[rank] as usize);
    Whitened::store(whitened, shapes, rank * WHITENED);
    rect.store(rects, rank);
}

#[cube]
fn load_sums(sums: &[f32], i: usize) -> RayGrad {
    let o = i * WHITENED_SUMS;
    RayGrad {
        a: Vec3::load(sums, o),
        b: Vec3::load(sums, o + 3),
        z: Vec3::load(sums, o + 6),
        distance: sums[o + 9],
        x: sums[o + 10],
        y: sums[o + 11],
        depth: 0.0f32,
    }
}

#[cube]
fn keep(kept: bool, value: Vec3) -> Vec3 {
    vec3(select(kept, value.x, 0.0f32), select(kept, value.y, 0.0f32), select(kept, value.z, 0.0f32))
}

#[cube(launch)]
fn backward_kernel(
    gaussians: &GaussianBuffers,
    sums: &[f32],
    first: &mut [f32],
    second: &mut [f32],
    view: CameraUniforms,
    count: u32,
    #[comptime] of_place: bool,
) {
    let i = ABSOLUTE_POS;
    if i >= count as usize {
        terminate!();
    }
    let quaternion = row4(&gaussians.quaternions, i);
    let relative = relative(row3(&gaussians.log_scales, i));
    let rows = rows(camera_axes(view, rotation(quaternion)), relative);
    let (whitened, _rect) = seen(gaussians, view, i);
    // one that is not drawn has no sums
    let drawn = whitened.strength > 0.0f32;
    let (grad, power) = (load_sums(sums, i), sums[i * WHITENED_SUMS + 12]);
    let back = transpose(view.rotation);
    let towards = scale(whitened.towards(grad, view), 1.0f32 / whitened.depth);
    let slope_x = (whitened.mean_x - view.cx) / view.fx;
    let slope_y = (whitened.mean_y - view.cy) / view.fy;
    let grad_z = minus(grad.z, add(scale(grad.a, slope_x), scale(grad.b, slope_y)));
    let of_scales = add(add(times(rows.row0, grad.a), times(rows.row1, grad.b)), times(rows.row2, grad_z));
    // rows = W R · relative scales
    let grad_axes =
        Mat3 { row0: times(grad.a, relative), row1: times(grad.b, relative), row2: times(grad_z, relative) };
    let by_axes = transpose(grad_axes);
    let columns = Mat3 {
        row0: apply(back, keep(drawn, by_axes.row0)),
        row1: apply(back, keep(drawn, by_axes.row1)),
        row2: apply(back, keep(drawn, by_axes.row2)),
    };
    let gradient = SplatGradient {
        position: keep(drawn, apply(back, towards)),
        quaternion: rotation_backward(quaternion, transpose(columns)),
        log_scales: keep(drawn, of_scales),
        // both values of `select` are computed
        opacity: select(drawn, power / max(whitened.strength, 1e-30f32), 0.0f32),
    };
    store_gradient(gradient, first, second, i, of_place);
}

/// [M, [`WHITENED`]] of the primitives in an `order`, and [M, [`RECT`]] the pixels that they can reach.
pub fn shapes(
    gaussians: &GaussianTensors<CubeBackend>,
    order: &CubeTensor,
    camera: &Camera,
) -> (CubeTensor, CubeTensor) {
    let like = &gaussians.positions;
    let count = like.shape()[0];
    let (shapes, rects) = (empty_f32(like, [count, WHITENED]), empty_u32(like, [count, RECT]));
    whitened_kernel::launch(
        &like.client.clone(),
        units(count),
        cube_dim(),
        GaussianBuffers::launch(gaussians),
        buffer(order),
        buffer(&shapes),
        buffer(&rects),
        CameraUniforms::launch(camera),
        count as u32,
    );
    (shapes, rects)
}

/// Writes the gradients with respect to positions, quaternions, log-scales and opacities into `out`, from the `sums`
/// [M, [`WHITENED_SUMS`]]; that of the depth of the centre is not included.
pub fn backward(
    gaussians: &GaussianTensors<CubeBackend>,
    sums: &CubeTensor,
    camera: &Camera,
    out: &GaussianTensors<CubeBackend>,
) {
    let count = sums.shape()[0];
    for (of_place, first, second) in parts(out) {
        backward_kernel::launch(
            &sums.client.clone(),
            units(count),
            cube_dim(),
            GaussianBuffers::launch(gaussians),
            buffer(sums),
            buffer(first),
            buffer(second),
            CameraUniforms::launch(camera),
            count as u32,
            of_place,
        );
    }
}
