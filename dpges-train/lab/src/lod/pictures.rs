//! Pictures of a whole scene, and smaller ones of them, for its coarser levels.

use burn::tensor::Device;
use dpges_core::Result;
use dpges_core::camera::{Camera, CameraFromWorld};
use dpges_core::scene::SceneData;
use dpges_core::scene::tensors::tensor_to_rows;
use dpges_train::dataset::neighbours::as_points;
use dpges_train::dataset::{Picture, View};
use dpges_train::eval::rendered::TrainingRenderer;
use glam::DVec3;

use super::tree::quantiles;

/// Cameras that pictures are made from, at most.
const CAMERAS: usize = 64;
/// Pictures whose shorter side would be less, px, are not made smaller.
const SMALLEST_PX: usize = 32;
/// Cameras around a scene that has none, their pictures and lenses.
const AROUND: usize = 24;
const SIDE_PX: usize = 512;

/// Pictures of one scene from the same cameras, by level: those of level l have 1/2^l of the sides.
pub struct Pictures {
    /// From level 1, if they can be smaller than the camera's.
    levels: Vec<Vec<View>>,
}

impl Pictures {
    /// Of `scene` from at most [`CAMERAS`] of `cameras`, for levels 1 to `coarsest`, rendered on `device` at their own size,
    /// cropped to whole pixels of the coarsest; a smaller picture is the mean of two by two pixels of the one before.
    pub fn new(scene: &SceneData, cameras: &[Camera], coarsest: u32, device: &Device) -> Result<Self> {
        let renderer = TrainingRenderer::new(scene, device);
        let stride = cameras.len().div_ceil(CAMERAS).max(1);
        let smaller = |camera: &Camera| (camera.width.min(camera.height) / SMALLEST_PX).max(1).ilog2();
        let most = cameras.iter().map(smaller).min().unwrap_or(0).min(coarsest);
        let mut levels: Vec<Vec<View>> = vec![Vec::new(); most.max(1) as usize];
        for (number, camera) in cameras.iter().step_by(stride).enumerate() {
            let whole = |side: usize| (side >> most) << most;
            // the left upper part of the picture
            let mut camera = Camera { width: whole(camera.width), height: whole(camera.height), ..*camera };
            let mut planes = tensor_to_rows(renderer.render(&camera)?.image());
            for level in &mut levels {
                if most > 0 {
                    planes = halved(&planes, camera.width);
                    camera = camera.resized(camera.width / 2, camera.height / 2);
                }
                let photograph = Picture::from_planes(&planes, camera.width, camera.height).into();
                level.push(View { name: format!("view_{number:03}"), camera, photograph, depth: None, face: None });
            }
        }
        Ok(Self { levels })
    }

    /// Those of `level`, which is not 0, or the smallest there are.
    pub fn of(&self, level: u32) -> &[View] {
        &self.levels[(level as usize).min(self.levels.len()) - 1]
    }
}

/// Planes of half the width and height: means of two by two pixels.
fn halved(planes: &[f32], width: usize) -> Vec<f32> {
    let rows = planes.chunks_exact(2 * width);
    let pixel =
        |rows: &[f32], x: usize| 0.25 * (rows[2 * x] + rows[2 * x + 1] + rows[width + 2 * x] + rows[width + 2 * x + 1]);
    rows.flat_map(|rows| (0..width / 2).map(move |x| pixel(rows, x))).collect()
}

/// Cameras all around the middle nine tenths of `scene`, which look at its middle from outside.
pub fn around(scene: &SceneData) -> Vec<Camera> {
    let points = || as_points(&scene.surfels.positions).iter().chain(as_points(&scene.gaussians.positions));
    let [low, high] = quantiles(points(), scene.surfels.len() + scene.gaussians.len(), [0.05, 0.95]);
    let (middle, radius) = (0.5 * (low + high), (0.5 * (high - low).length()).max(10.0 * scene.info.near));
    let camera = |number: usize| {
        // a spiral over the sphere, in turns of the golden angle
        let height = 1.0 - (2 * number + 1) as f64 / AROUND as f64;
        let (sine, cosine) = (number as f64 * std::f64::consts::PI * (3.0 - 5f64.sqrt())).sin_cos();
        let flat = (1.0 - height * height).sqrt();
        let eye = middle + 2.5 * radius * DVec3::new(flat * cosine, height, flat * sine);
        let pose = CameraFromWorld::look_at(eye, middle, DVec3::Y);
        Camera::pinhole(pose, SIDE_PX as f64, [SIDE_PX; 2], scene.info.near)
    };
    (0..AROUND).map(camera).collect()
}
