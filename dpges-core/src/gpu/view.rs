//! A camera as kernels see it.

use cubecl::prelude::*;
use glam::DMat3;

use super::lens::{LensKind, LensUniforms, ray};
use super::rect::Rect;
use super::vector::{Mat3, Mat3Launch, Vec3, Vec3Launch, add, apply, dot, scale, transpose, vec3};
use crate::camera::Camera;
use crate::tiles::TileGrid;

/// Uniforms of every kernel that looks through a camera.
#[derive(CubeType, CubeLaunch, Clone, Copy)]
#[expand(derive(Clone, Copy))]
pub struct CameraUniforms {
    /// Rotation from world to camera axes.
    pub rotation: Mat3,
    pub translation: Vec3,
    /// Camera centre in world units.
    pub centre: Vec3,
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
        let pose = &camera.camera_from_world;
        let grid = TileGrid::new(camera.width, camera.height);
        CameraUniformsLaunch::new(
            Mat3Launch::of(pose.rotation),
            Vec3Launch::of(pose.translation),
            Vec3Launch::of(camera.centre()),
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

/// Axes of a primitive, the columns of `world`, in camera axes, by rows.
#[cube]
pub fn camera_axes(view: CameraUniforms, world: Mat3) -> Mat3 {
    let (pose, axes) = (view.rotation, transpose(world));
    Mat3 { row0: apply(pose, axes.row0), row1: apply(pose, axes.row1), row2: apply(pose, axes.row2) }
}

/// World point in camera axes.
#[cube]
pub fn to_camera(view: CameraUniforms, world: Vec3) -> Vec3 {
    add(apply(view.rotation, world), view.translation)
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
        apply(transpose(view.rotation), scale(point, 1.0f32 / view_depth(view, point)))
    } else {
        view.rotation.row2
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
    // clamped before the cast, whose result is undefined in SPIR-V beyond the range of u32
    let first = clamp(f32::ceil(low - 0.5f32), 0.0f32, most);
    let end = clamp(f32::floor(high - 0.5f32) + 1.0f32, 0.0f32, most);
    (u32::cast_from(first), u32::cast_from(end))
}

/// Pixels whose centres lie in [x0, x1] and [y0, y1] px; none unless `visible`.
#[cube]
pub fn pixels_within(view: CameraUniforms, visible: bool, x0: f32, x1: f32, y0: f32, y1: f32) -> Rect {
    let (first_x, end_x) = pixel_range(x0, x1, view.width);
    let (first_y, end_y) = pixel_range(y0, y1, view.height);
    Rect { x0: first_x, x1: select(visible, end_x, first_x), y0: first_y, y1: select(visible, end_y, first_y) }
}

/// Rounding errors of [`CameraUniforms`]: a number of the camera in f64 is the sum of the two.
#[derive(CubeType, CubeLaunch, Clone, Copy)]
#[expand(derive(Clone, Copy))]
pub struct Rests {
    pub rotation: Mat3,
    pub centre: Vec3,
    pub fx: f32,
    pub fy: f32,
    pub cx: f32,
    pub cy: f32,
}

impl Rests {
    pub fn launch(camera: &Camera) -> RestsLaunch {
        // exact in f64: an edge-on disc magnifies what f32 loses of a camera
        let rest = |v: f64| v - f64::from(v as f32);
        let [fx, fy, cx, cy] = [camera.fx, camera.fy, camera.cx, camera.cy].map(|v| rest(v) as f32);
        let rotation = DMat3::from_cols_array(&camera.camera_from_world.rotation.to_cols_array().map(rest));
        let centre = camera.centre().map(rest);
        RestsLaunch::new(Mat3Launch::of(rotation), Vec3Launch::of(centre), fx, fy, cx, cy)
    }
}
