//! How long frames take: what `bench`, `eval`, `trade` and targets in fps share.

use dpges_core::camera::Camera;
use dpges_core::scene::SceneData;
use dpges_render::frame_times::{FrameTimes, Rounds, frame_times};
use dpges_render::{Headless, RenderOptions};
use dpges_train::eval::rendered::Renderer;

use super::Result;

/// Of the real-time renderer, with the options of `scene`, from `cameras` without their lenses.
pub fn of_raster(headless: &Headless, scene: &SceneData, cameras: &[Camera], rounds: Rounds) -> Result<FrameTimes> {
    let mut renderer = headless.renderer()?;
    renderer.upload(scene)?;
    let cameras: Vec<Camera> = cameras.iter().map(Camera::without_lens).collect();
    Ok(frame_times(headless, &mut renderer, &cameras, &RenderOptions::from(&scene.info), rounds)?)
}

/// Of the renderer that is trained with.
pub fn of_training(renderer: &Renderer, cameras: &[Camera], rounds: Rounds) -> Result<FrameTimes> {
    Ok(renderer.frame_times(cameras, rounds)?)
}
