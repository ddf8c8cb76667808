//! GPU kernels: one unit per pixel; the gradient has one cube per coefficient, which visits all pixels.

use burn::backend::TensorMetadata;
use burn::backend::tensor::FloatTensor;
use burn_cubecl::CubeBackend;
use burn_cubecl::tensor::CubeTensor;
use cubecl::prelude::*;

use super::EnvironmentOps;
use super::autodiff::EnvironmentState;
use crate::backend::tape::BackwardState;
use crate::camera::Camera;
use crate::gpu::launch::{HALVINGS, UNITS, buffer, cube_dim, cubes, empty_f32, floats, units};
use crate::gpu::lens::{LensKind, LensUniforms, ray};
use crate::gpu::vector::{Vec3, dot, row3, scale, vec3};
use crate::ops::colour::cube::harmonic;

/// Rays of the pixels of a camera. Rows x, y and z of a matrix that maps (x, y, 1), px, to a vector along the ray in world axes, or,
/// through a lens, of the rotation to world axes.
#[derive(CubeType, CubeLaunch, Clone, Copy)]
#[expand(derive(Clone, Copy))]
struct Rays {
    xx: f32,
    xy: f32,
    xz: f32,
    yx: f32,
    yy: f32,
    yz: f32,
    zx: f32,
    zy: f32,
    zz: f32,
    width: u32,
    pixels: u32,
    fx: f32,
    fy: f32,
    cx: f32,
    cy: f32,
    lens: LensUniforms,
}

/// Unit vector in world axes along the ray through the centre of a pixel; 0 where a lens shows nothing.
#[cube]
fn direction(rays: Rays, pixel: u32) -> Vec3 {
    let x = f32::cast_from(pixel % rays.width) + 0.5f32;
    let y = f32::cast_from(pixel / rays.width) + 0.5f32;
    if comptime!(rays.lens.kind == LensKind::None) {
        let ray = vec3(
            rays.xx * x + rays.xy * y + rays.xz,
            rays.yx * x + rays.yy * y + rays.yz,
            rays.zx * x + rays.zy * y + rays.zz,
        );
        scale(ray, 1.0f32 / f32::sqrt(dot(ray, ray)))
    } else {
        let own = ray(rays.lens, (x - rays.cx) / rays.fx, (y - rays.cy) / rays.fy);
        let ray = vec3(
            rays.xx * own.x + rays.xy * own.y + rays.xz * own.z,
            rays.yx * own.x + rays.yy * own.y + rays.yz * own.z,
            rays.zx * own.x + rays.zy * own.y + rays.zz * own.z,
        );
        // 0 stays 0, where a lens shows nothing
        scale(ray, 1.0f32 / f32::sqrt(max(dot(ray, ray), 1e-30f32)))
    }
}

/// Value of a harmonic; 0 without a direction.
#[cube]
fn value(rays: Rays, d: Vec3, #[comptime] k: usize) -> f32 {
    let value = harmonic(d, k);
    // directions have a length of 1, or 0 where a lens shows nothing
    if comptime!(rays.lens.kind == LensKind::None) { value } else { select(dot(d, d) > 0.5f32, value, 0.0f32) }
}

#[cube(launch)]
fn environment_kernel(coefficients: &[f32], image: &mut [f32], rays: Rays, #[comptime] count: usize) {
    let pixel = ABSOLUTE_POS;
    if pixel >= rays.pixels as usize {
        terminate!();
    }
    let d = direction(rays, pixel as u32);
    let mut red = 0.0f32;
    let mut green = 0.0f32;
    let mut blue = 0.0f32;
    #[unroll]
    for k in 0..count {
        let value = value(rays, d, k);
        let row = row3(coefficients, k);
        red += value * row.x;
        green += value * row.y;
        blue += value * row.z;
    }
    let plane = rays.pixels as usize;
    image[pixel] = red;
    image[plane + pixel] = green;
    image[2 * plane + pixel] = blue;
}

#[cube(launch)]
fn environment_backward_kernel(grad: &[f32], coefficients: &mut [f32], rays: Rays, #[comptime] count: usize) {
    let own = CUBE_POS;
    if own >= count {
        terminate!();
    }
    let plane = rays.pixels as usize;
    let unit = UNIT_POS as usize;
    // a cube per coefficient: all 48 sums of every unit would take 48 KiB of workgroup memory, and WebGPU has 16
    let mut red = 0.0f32;
    let mut green = 0.0f32;
    let mut blue = 0.0f32;
    let mut pixel = UNIT_POS;
    while pixel < rays.pixels {
        let d = direction(rays, pixel);
        let mut share = 0.0f32;
        #[unroll]
        for k in 0..count {
            // `own` is not known to the compiler, and `harmonic` takes an index that is: one of these runs
            if own == k {
                share = value(rays, d, k);
            }
        }
        let at = pixel as usize;
        red += share * grad[at];
        green += share * grad[plane + at];
        blue += share * grad[2 * plane + at];
        pixel += UNITS;
    }
    let mut sums = Shared::<[f32]>::new_slice(comptime!(3 * UNITS as usize));
    sums[unit] = red;
    sums[UNITS as usize + unit] = green;
    sums[2 * UNITS as usize + unit] = blue;
    #[unroll]
    for halving in 0..HALVINGS {
        let step = comptime!((UNITS >> (halving + 1)) as usize);
        sync_cube();
        if unit < step {
            #[unroll]
            for channel in 0..3usize {
                let at = comptime!(channel * UNITS as usize) + unit;
                sums[at] += sums[at + step];
            }
        }
    }
    sync_cube();
    if unit < 3 {
        coefficients[3 * own + unit] = sums[unit * UNITS as usize];
    }
}

fn launch(camera: &Camera) -> RaysLaunch {
    let rows = match camera.lens {
        None => camera.world_from_pixel().transpose().to_cols_array_2d(),
        // by rows, so that the columns of the rotation are those of its transpose
        Some(_) => camera.camera_from_world.rotation.to_cols_array_2d(),
    };
    let [[xx, xy, xz], [yx, yy, yz], [zx, zy, zz]] = rows.map(|row| row.map(|v| v as f32));
    let [fx, fy, cx, cy] = [camera.fx, camera.fy, camera.cx, camera.cy].map(|v| v as f32);
    let lens = LensUniforms::launch(camera);
    let pixels = (camera.width * camera.height) as u32;
    RaysLaunch::new(xx, xy, xz, yx, yy, yz, zx, zy, zz, camera.width as u32, pixels, fx, fy, cx, cy, lens)
}

impl EnvironmentOps for CubeBackend {
    fn environment(coefficients: FloatTensor<Self>, camera: Camera) -> FloatTensor<Self> {
        let coefficients = floats(coefficients);
        let image = empty_f32(&coefficients, [3, camera.height, camera.width]);
        environment_kernel::launch(
            &coefficients.client.clone(),
            units(camera.width * camera.height),
            cube_dim(),
            buffer(&coefficients),
            buffer(&image),
            launch(&camera),
            coefficients.shape()[0],
        );
        image
    }
}

impl BackwardState<CubeBackend, 1> for EnvironmentState {
    fn backward(self, grad: CubeTensor) -> [Option<CubeTensor>; 1] {
        let Self { camera, count } = self;
        let grad = floats(grad);
        let coefficients = empty_f32(&grad, [count, 3]);
        environment_backward_kernel::launch(
            &grad.client.clone(),
            cubes(count),
            cube_dim(),
            buffer(&grad),
            buffer(&coefficients),
            launch(&camera),
            count,
        );
        [Some(coefficients)]
    }
}
