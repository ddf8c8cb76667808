//! How far along a ray a Gaussian is (StopThePop), on the device; the CPU's twin is
//! [`cpu::along_ray`](super::super::cpu::along_ray).

use burn::backend::TensorMetadata;
use burn_cubecl::CubeBackend;
use burn_cubecl::tensor::CubeTensor;
use cubecl::prelude::*;

use super::super::cpu::along_ray;
use super::super::tensors::GaussianTensors;
use super::{SPLAT, Splat};
use crate::camera::Camera;
use crate::gpu::launch::{buffer, cube_dim, empty_f32, units};
use crate::gpu::lens::{LensKind, ray};
use crate::gpu::record::{Record, record};
use crate::gpu::vector::{Mat3, Vec3, apply, dot, rotation, row3, row4, scale, vec3};
use crate::gpu::view::{CameraUniforms, camera_axes, to_camera};

const MIN_SCALE: f32 = along_ray::MIN_SCALE as f32;
const MIN_FORM: f32 = along_ray::MIN_FORM as f32;

record! {
    /// A Gaussian as rays meet it: S⁻¹ Rᵀ by rows, from camera axes to standard deviations, and the centre in standard
    /// deviations from the camera.
    pub struct AlongRay {
        pub row0: Vec3,
        pub row1: Vec3,
        pub row2: Vec3,
        pub centre: Vec3,
    }
}

#[cube]
impl AlongRay {
    /// The values of the Gaussian with these axes, by rows, and this centre, in camera axes.
    pub fn new(axes: Mat3, log_scales: Vec3, centre: Vec3) -> AlongRay {
        let least = MIN_SCALE * f32::sqrt(dot(centre, centre));
        let whitening = Mat3 {
            row0: scale(axes.row0, 1.0f32 / max(f32::exp(log_scales.x), least)),
            row1: scale(axes.row1, 1.0f32 / max(f32::exp(log_scales.y), least)),
            row2: scale(axes.row2, 1.0f32 / max(f32::exp(log_scales.z), least)),
        };
        let centre = apply(whitening, centre);
        AlongRay { row0: whitening.row0, row1: whitening.row1, row2: whitening.row2, centre }
    }

    /// t* along a [`unit_ray`], world units from the camera.
    pub fn depth(&self, ray: Vec3) -> f32 {
        let along = vec3(dot(self.row0, ray), dot(self.row1, ray), dot(self.row2, ray));
        dot(along, self.centre) / max(dot(along, along), MIN_FORM)
    }
}

/// Unit vector of the ray through a point of the image, px, in camera axes; 0 where a lens shows nothing.
#[cube]
pub fn unit_ray(view: CameraUniforms, x: f32, y: f32) -> Vec3 {
    let (across, down) = ((x - view.cx) / view.fx, (y - view.cy) / view.fy);
    if comptime!(view.lens.kind == LensKind::None) {
        let along = vec3(across, down, 1.0f32);
        scale(along, 1.0f32 / f32::sqrt(dot(along, along)))
    } else {
        let along = ray(view.lens, across, down);
        scale(along, 1.0f32 / f32::sqrt(max(dot(along, along), 1e-20f32)))
    }
}

/// Number of values in a row of the table: a [`Splat`] and an [`AlongRay`].
pub const ROW: usize = SPLAT + AlongRay::LEN;

#[cube(launch)]
fn table_kernel(
    positions: &[f32],
    quaternions: &[f32],
    log_scales: &[f32],
    order: &[u32],
    splats: &[f32],
    table: &mut [f32],
    view: CameraUniforms,
    count: u32,
) {
    let rank = ABSOLUTE_POS;
    if rank >= count as usize {
        terminate!();
    }
    let i = order[rank] as usize;
    let axes = camera_axes(view, rotation(row4(quaternions, i)));
    let along = AlongRay::new(axes, row3(log_scales, i), to_camera(view, row3(positions, i)));
    let splat = Splat::load(splats, rank * SPLAT);
    Splat::store(splat, table, rank * ROW);
    AlongRay::store(along, table, rank * ROW + SPLAT);
}

/// [M, [`ROW`]] how rays meet every primitive in an `order`, and its footprint of `splats`.
pub fn table(
    gaussians: &GaussianTensors<CubeBackend>,
    order: &CubeTensor,
    splats: &CubeTensor,
    camera: &Camera,
) -> CubeTensor {
    let count = splats.shape()[0];
    let table = empty_f32(splats, [count, ROW]);
    table_kernel::launch(
        &splats.client.clone(),
        units(count),
        cube_dim(),
        buffer(&gaussians.positions),
        buffer(&gaussians.quaternions),
        buffer(&gaussians.log_scales),
        buffer(order),
        buffer(splats),
        buffer(&table),
        CameraUniforms::launch(camera),
        count as u32,
    );
    table
}
