//! A camera as kernels see it.

use cubecl::prelude::*;

use super::lens::{LensKind, LensUniforms, ray};
use super::vector::{Mat3, Vec3, add, apply, dot, scale, transpose, vec3};
use crate::camera::Camera;
use crate::tiles::TileGrid;

/// Uniforms of every kernel that looks through a camera.
#[derive(CubeType, CubeLaunch, Clone, Copy)]
#[expand(derive(Clone, Copy))]
pub struct CameraUniforms {
    pub r00: f32,
    pub r01: f32,
    pub r02: f32,
    pub r10: f32,
    pub r11: f32,
    pub r12: f32,
    pub r20: f32,
    pub r21: f32,
    pub r22: f32,
    pub tx: f32,
    pub ty: f32,
    pub tz: f32,
    /// Camera centre in world units.
    pub centre_x: f32,
    pub centre_y: f32,
    pub centre_z: f32,
    pub fx: f32,
    pub fy: f32,
    pub cx: f32,
    pub cy: f32,
    pub near: f32,
    /// +∞. WGSL rejects a constant infinity.
    pub infinity: f32,
    /// Always 0, but the compiler does not know: see [`super::exact`].
    pub zero: u32,
    pub width: u32,
    pub height: u32,
    /// Tiles along each axis.
    pub columns: u32,
    pub rows: u32,
    pub lens: LensUniforms,
}

impl CameraUniforms {
    pub fn launch(camera: &Camera) -> CameraUniformsLaunch {
        let rotation = camera.camera_from_world.rotation.transpose().to_cols_array_2d();
        let [r0, r1, r2] = rotation.map(|row| row.map(|v| v as f32));
        let t = camera.camera_from_world.translation.to_array().map(|v| v as f32);
        let centre = camera.centre().to_array().map(|v| v as f32);
        let grid = TileGrid::new(camera.width, camera.height);
        CameraUniformsLaunch::new(
            r0[0],
            r0[1],
            r0[2],
            r1[0],
            r1[1],
            r1[2],
            r2[0],
            r2[1],
            r2[2],
            t[0],
            t[1],
            t[2],
            centre[0],
            centre[1],
            centre[2],
            camera.fx as f32,
            camera.fy as f32,
            camera.cx as f32,
            camera.cy as f32,
            camera.near as f32,
            f32::INFINITY,
            0,
            camera.width as u32,
            camera.height as u32,
            grid.columns as u32,
            grid.rows as u32,
            LensUniforms::launch(camera),
        )
    }
}

#[cube]
pub fn view_rotation(view: CameraUniforms) -> Mat3 {
    Mat3 {
        row0: vec3(view.r00, view.r01, view.r02),
        row1: vec3(view.r10, view.r11, view.r12),
        row2: vec3(view.r20, view.r21, view.r22),
    }
}

/// World point in camera axes.
#[cube]
pub fn to_camera(view: CameraUniforms, world: Vec3) -> Vec3 {
    add(apply(view_rotation(view), world), vec3(view.tx, view.ty, view.tz))
}

/// Depth of a point in camera axes.
#[cube]
pub fn view_depth(view: CameraUniforms, point: Vec3) -> f32 {
    if comptime!(view.lens.kind == LensKind::Arc) { f32::sqrt(dot(point, point)) } else { point.z }
}

/// Gradient of the depth of a point in camera axes with respect to the point, in world axes.
#[cube]
pub fn depth_slope(view: CameraUniforms, point: Vec3) -> Vec3 {
    if comptime!(view.lens.kind == LensKind::Arc) {
        apply(transpose(view_rotation(view)), scale(point, 1.0f32 / view_depth(view, point)))
    } else {
        view_rotation(view).row2
    }
}

/// The argument of a disc at the point (`x`, `y`) px: that point, or its ray through a lens, camera axes, of depth 1
/// and 0 where the lens shows nothing.
#[cube]
pub fn sight(view: CameraUniforms, x: f32, y: f32) -> Vec3 {
    if comptime!(view.lens.kind == LensKind::None) {
        vec3(x, y, 1.0f32)
    } else {
        ray(view.lens, (x - view.cx) / view.fx, (y - view.cy) / view.fy)
    }
}

/// First pixel (inclusive) and end (exclusive) whose centres lie in [low, high] px, of `size` px.
#[cube]
pub fn pixel_range(low: f32, high: f32, size: u32) -> (u32, u32) {
    let most = f32::cast_from(size);
    let first = clamp(f32::ceil(low - 0.5f32), 0.0f32, most);
    let end = clamp(f32::floor(high - 0.5f32) + 1.0f32, 0.0f32, most);
    (u32::cast_from(first), u32::cast_from(end))
}

/// Rounding errors of [`CameraUniforms`]: a number of the camera in f64 is the sum of the two.
#[derive(CubeType, CubeLaunch, Clone, Copy)]
#[expand(derive(Clone, Copy))]
pub struct Rests {
    pub r00: f32,
    pub r01: f32,
    pub r02: f32,
    pub r10: f32,
    pub r11: f32,
    pub r12: f32,
    pub r20: f32,
    pub r21: f32,
    pub r22: f32,
    pub centre_x: f32,
    pub centre_y: f32,
    pub centre_z: f32,
    pub fx: f32,
    pub fy: f32,
    pub cx: f32,
    pub cy: f32,
}

impl Rests {
    pub fn launch(camera: &Camera) -> RestsLaunch {
        let rest = |v: f64| (v - f64::from(v as f32)) as f32;
        let [r0, r1, r2] = camera.camera_from_world.rotation.transpose().to_cols_array_2d().map(|row| row.map(rest));
        let [x, y, z] = camera.centre().to_array().map(rest);
        let [fx, fy, cx, cy] = [camera.fx, camera.fy, camera.cx, camera.cy].map(rest);
        RestsLaunch::new(r0[0], r0[1], r0[2], r1[0], r1[1], r1[2], r2[0], r2[1], r2[2], x, y, z, fx, fy, cx, cy)
    }
}
