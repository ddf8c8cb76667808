//! How long frames of the renderer take that is trained with.

use dpges_core::camera::Camera;
use dpges_render::frame_times::{FrameTimes, Rounds};
use dpges_train::eval::rendered::Renderer;

use super::Result;

pub fn of_training(renderer: &Renderer, cameras: &[Camera], rounds: Rounds) -> Result<FrameTimes> {
    Ok(renderer.frame_times(cameras, rounds)?)
}
