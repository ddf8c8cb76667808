//! Gradients of the raw parameters of every primitive, from the sums over its pixels.

use burn::backend::TensorMetadata;
use burn_cubecl::CubeBackend;
use burn_cubecl::tensor::CubeTensor;
use cubecl::prelude::*;

use super::fold::{Layout, PROBE};
use super::fragments::{LOW_PASS_SQUARED_RADIUS as K, discs, facing_sign, magnitudes, normal_axis, own_normal};
use crate::camera::Camera;
use crate::footprint::gaussian::cube as splat_cube;
use crate::footprint::gaussian::cube::whitened as whitened_cube;
use crate::footprint::gaussian::tensors::GaussianTensors;
use crate::footprint::surfel::cube as disc_cube;
use crate::footprint::surfel::cube::bounded_scale;
use crate::gpu::gather::zeros;
use crate::gpu::launch::{buffer, cube_dim, empty_f32, units};
use crate::gpu::record::Record;
use crate::gpu::vector::{
    Mat3, Vec3, add3, apply, dot, rotation, rotation_backward, row3, row4, scale, transpose, vec3, write3,
};
use crate::gpu::view::{CameraUniforms, camera_axes, depth_slope, to_camera};
use crate::ops::blend::{BlendInput, Form};
use crate::scene::ScreenFilter;

/// Colours, probe, opacities of discs and of students, and degrees of freedom of these.
#[cube(launch)]
fn payload_kernel(
    rest: &[f32],
    opacities: &[f32],
    grad_colours: &mut [f32],
    grad_probe: &mut [f32],
    grad_opacities: &mut [f32],
    grad_degrees: &mut [f32],
    count: u32,
    #[comptime] layout: Layout,
) {
    let i = ABSOLUTE_POS;
    if i >= count as usize {
        terminate!();
    }
    let width = comptime!(layout.rest());
    let degrees = comptime!(layout.beside() + 1);
    let probe = comptime!(layout.probe());
    let exponent = comptime!(layout.beside() + 2);
    let o = i * width;
    write3(grad_colours, i, Vec3::load(rest, o));
    if comptime!(layout.probe) {
        #[unroll]
        for number in 0..PROBE {
            grad_probe[PROBE * i + number] = rest[o + probe + number];
        }
    }
    if comptime!(layout.form == Form::Discs) {
        let (opacity, power) = (opacities[i], rest[o + exponent]);
        // both values of `select` are computed, so that the divisor must not be 0
        grad_opacities[i] = select(opacity > 0.0f32, power / max(opacity, 1e-30f32), 0.0f32);
    }
    if comptime!(layout.form == Form::Students) {
        let (opacity, power) = (opacities[i], rest[o + exponent]);
        let drawn = power != 0.0f32;
        // an opacity may be negative here, so that no maximum keeps the divisor away from 0
        grad_opacities[i] = select(drawn, power / select(drawn, opacity, 1.0f32), 0.0f32);
        grad_degrees[i] = rest[o + degrees];
    }
}

/// Adds what the sums of the shape lack: the depth of an ellipsoid's centre, the low-pass of a disc,
/// the normal.
#[cube(launch)]
fn rest_kernel(
    positions: &[f32],
    quaternions: &[f32],
    log_scales: &[f32],
    rest: &[f32],
    grad_positions: &mut [f32],
    grad_quaternions: &mut [f32],
    grad_log_scales: &mut [f32],
    view: CameraUniforms,
    count: u32,
    #[comptime] layout: Layout,
) {
    let i = ABSOLUTE_POS;
    if i >= count as usize {
        terminate!();
    }
    let form = comptime!(layout.form);
    let width = comptime!(layout.rest());
    let place = comptime!(layout.beside());
    let normal = comptime!(layout.normal());
    let o = i * width;
    let beside = o + place;
    let pose = view.rotation;
    let back = transpose(pose);
    let centre = to_camera(view, row3(positions, i));
    let quaternion = row4(quaternions, i);
    let log_scales = row3(log_scales, i);
    let axes = camera_axes(view, rotation(quaternion));
    // gradients with respect to the axes in camera space
    let mut of_axes = zeros(9usize);
    if comptime!(layout.maps) {
        let at = o + normal;
        let sign = facing_sign(own_normal(axes, log_scales, form), centre);
        let towards = scale(Vec3::load(rest, at), sign);
        let own = normal_axis(log_scales, form);
        #[unroll]
        for axis in 0..3usize {
            let is_normal = own == axis as u32;
            of_axes[3 * axis] = select(is_normal, towards.x, 0.0f32);
            of_axes[3 * axis + 1] = select(is_normal, towards.y, 0.0f32);
            of_axes[3 * axis + 2] = select(is_normal, towards.z, 0.0f32);
        }
    }
    if comptime!(form != Form::Discs) {
        let moved = scale(depth_slope(view, centre), rest[beside]);
        add3(grad_positions, i, moved);
    } else {
        let (scale_u, scale_v) = (bounded_scale(log_scales.x), bounded_scale(log_scales.y));
        let (a, b) = (scale(axes.row0, scale_u), scale(axes.row1, scale_v));
        let bulk = K * (a.z * a.z + b.z * b.z) - centre.z * centre.z;
        // as forward: a disc that reaches the plane of the camera has no low-pass filter
        if bulk < 0.0f32 {
            let inverse = 1.0f32 / bulk;
            // centre of the box: slopes (K (aᵢ a_z + bᵢ b_z) − cᵢ c_z) / bulk
            let slope_x = (K * (a.x * a.z + b.x * b.z) - centre.x * centre.z) * inverse;
            let slope_y = (K * (a.y * a.z + b.y * b.z) - centre.y * centre.z) * inverse;
            let towards_x = view.fx * rest[beside] * inverse;
            let towards_y = view.fy * rest[beside + 1] * inverse;
            let (twice_x, twice_y) = (2.0f32 * slope_x, 2.0f32 * slope_y);
            let of_a = vec3(
                K * a.z * towards_x,
                K * a.z * towards_y,
                K * (towards_x * (a.x - twice_x * a.z) + towards_y * (a.y - twice_y * a.z)),
            );
            let of_b = vec3(
                K * b.z * towards_x,
                K * b.z * towards_y,
                K * (towards_x * (b.x - twice_x * b.z) + towards_y * (b.y - twice_y * b.z)),
            );
            let of_centre = vec3(
                -centre.z * towards_x,
                -centre.z * towards_y,
                towards_x * (twice_x * centre.z - centre.x) + towards_y * (twice_y * centre.z - centre.y),
            );
            let moved = apply(back, of_centre);
            add3(grad_positions, i, moved);
            grad_log_scales[3 * i] += dot(of_a, a);
            grad_log_scales[3 * i + 1] += dot(of_b, b);
            of_axes[0] += scale_u * of_a.x;
            of_axes[1] += scale_u * of_a.y;
            of_axes[2] += scale_u * of_a.z;
            of_axes[3] += scale_v * of_b.x;
            of_axes[4] += scale_v * of_b.y;
            of_axes[5] += scale_v * of_b.z;
        }
    }
    let columns = Mat3 {
        row0: apply(back, vec3(of_axes[0], of_axes[1], of_axes[2])),
        row1: apply(back, vec3(of_axes[3], of_axes[4], of_axes[5])),
        row2: apply(back, vec3(of_axes[6], of_axes[7], of_axes[8])),
    };
    // added, since the kernel of the shape has written its part before
    let turned = rotation_backward(quaternion, transpose(columns));
    grad_quaternions[4 * i] += turned.w;
    grad_quaternions[4 * i + 1] += turned.x;
    grad_quaternions[4 * i + 2] += turned.y;
    grad_quaternions[4 * i + 3] += turned.z;
}

/// Gradients with respect to the input, from the sums of the shape and the rest of them.
pub fn backward(
    gaussians: &GaussianTensors<CubeBackend>,
    sums: &CubeTensor,
    rest: &CubeTensor,
    camera: &Camera,
    filter: ScreenFilter,
    layout: Layout,
) -> BlendInput<CubeBackend> {
    let (client, count) = (sums.client.clone(), sums.shape()[0]);
    let out = GaussianTensors::empty(sums, count);
    let probe = empty_f32(sums, [if layout.probe { count } else { 0 }, PROBE]);
    let degrees = empty_f32(sums, [if layout.form == Form::Students { count } else { 0 }]);
    match layout.form {
        Form::Ellipsoids => splat_cube::backward(gaussians, sums, camera, filter, &out),
        Form::Students => splat_cube::backward(&magnitudes(gaussians), sums, camera, ScreenFilter::Off, &out),
        Form::Discs => disc_cube::backward(&discs(gaussians), sums, camera, &discs(&out)),
        Form::Whitened => whitened_cube::backward(gaussians, sums, camera, &out),
    }
    payload_kernel::launch(
        &client,
        units(count),
        cube_dim(),
        buffer(rest),
        buffer(&gaussians.opacities),
        buffer(&out.colours),
        buffer(&probe),
        buffer(&out.opacities),
        buffer(&degrees),
        count as u32,
        layout,
    );
    // of ellipsoids and students without maps there is nothing to add
    if layout.maps || layout.form == Form::Discs {
        rest_kernel::launch(
            &client,
            units(count),
            cube_dim(),
            buffer(&gaussians.positions),
            buffer(&gaussians.quaternions),
            buffer(&gaussians.log_scales),
            buffer(rest),
            buffer(&out.positions),
            buffer(&out.quaternions),
            buffer(&out.log_scales),
            CameraUniforms::launch(camera),
            count as u32,
            layout,
        );
    }
    BlendInput { gaussians: out, degrees_of_freedom: degrees, probe }
}
