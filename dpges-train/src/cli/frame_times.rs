//! How long frames take: what `bench`, `eval`, `trade` and targets in fps share.

use std::time::Instant;

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
    let mut times = Vec::new();
    for round in 0..rounds.warm_up + rounds.counted {
        for camera in cameras {
            let start = Instant::now();
            // reading one number waits for the picture
            drop(renderer.render(camera)?.image().clone().slice([0..1, 0..1, 0..1]).into_data());
            if round >= rounds.warm_up {
                times.push(1e3 * start.elapsed().as_secs_f64());
            }
        }
    }
    Ok(FrameTimes::new(times, Vec::new()))
}
