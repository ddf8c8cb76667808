//! Messages from and to the page, as JSON: cameras, options, properties of a scene.

use dpges_core::camera::{Camera, CameraFromWorld};
use dpges_core::scene::{Peeling, SceneInfo};
use dpges_render::{Display, RenderOptions};
use serde::{Deserialize, Serialize};

/// A camera in the convention of `cameras.json` of 3DGS, in the scene's coordinates; the principal point is the centre.
#[derive(Deserialize)]
pub struct PageCamera {
    /// World units.
    position: [f64; 3],
    /// Camera to world, row-major; columns: right, down, forward.
    rotation: [[f64; 3]; 3],
    /// px
    fx: f64,
    /// px
    fy: f64,
    /// px
    width: usize,
    /// px
    height: usize,
}

impl PageCamera {
    /// The camera, which draws primitives beyond `near` (world units).
    pub fn camera(&self, near: f64) -> Camera {
        let mut camera_from_world = CameraFromWorld::from_quaternion([1.0, 0.0, 0.0, 0.0], [0.0; 3].into());
        let rotation = &mut camera_from_world.rotation;
        // The rows of a rotation are the columns of its inverse.
        [rotation.x_axis, rotation.y_axis, rotation.z_axis] = self.rotation.map(Into::into);
        camera_from_world.translation = -camera_from_world.rotation.mul_vec3(self.position.into());
        Camera {
            camera_from_world,
            fx: self.fx,
            fy: self.fy,
            cx: 0.5 * self.width as f64,
            cy: 0.5 * self.height as f64,
            width: self.width,
            height: self.height,
            near,
            lens: None,
        }
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PageOptions {
    display: Display,
    layer_count: usize,
    modulation: f64,
    peeling: Peeling,
    /// Red, green, blue from 0 to 1.
    background: [f64; 3],
}

impl PageOptions {
    pub fn options(&self, scene: &SceneInfo) -> RenderOptions {
        let Self { display, layer_count, modulation, peeling, background } = *self;
        RenderOptions { display, layer_count, modulation, peeling, background, ..RenderOptions::from(scene) }
    }
}

#[derive(Serialize)]
pub struct Summary<'a> {
    pub surfels: usize,
    pub gaussians: usize,
    /// World units.
    pub centre: [f64; 3],
    /// World units.
    pub radius: f64,
    #[serde(flatten)]
    pub info: &'a SceneInfo,
}

#[derive(Serialize)]
pub struct Device<'a> {
    pub backend: &'a str,
    pub adapter: String,
    /// Bits per number between the passes.
    pub precision_bits: u32,
    /// Longest side of a picture, px.
    pub largest_px: u32,
}
