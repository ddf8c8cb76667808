//! Frame times of a scene, as its evaluation reports them.

use dpges_core::camera::Camera;
use dpges_core::scene::SceneData;
use dpges_render::frame_times::{FrameTimes, Rounds, scene_frame_times};
use dpges_render::path::Size;
use dpges_render::{Headless, RenderError, check_drawn};
use serde::{Deserialize, Serialize};

use super::rendered::Renderer;
use crate::dataset::View;

/// At most so many views are timed.
const TIMED_VIEWS: usize = 16;
const ROUNDS: Rounds = Rounds { warm_up: 1, counted: 10 };

/// Times of the frames of a renderer, and what they were measured on.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FrameMs {
    /// Median, ms.
    pub p50: f64,
    /// The time that 99 % of the frames do not exceed, ms.
    pub p99: f64,
    /// Name and interface of the adapter; of the renderer that is trained with the name of the device.
    pub device: String,
    /// px
    pub width: usize,
    /// px
    pub height: usize,
    /// `raster`, the real-time one, or `training`.
    pub renderer: String,
}

impl FrameMs {
    /// Times of `scene` in real time from some of `views`, at the size of the first. A scene that is not drawn in real time is
    /// drawn by `renderer`, that of training, on the `device` that is called so.
    ///
    /// # Errors
    /// [`RenderError`] without an adapter, or if a renderer refuses the scene or the cameras.
    ///
    /// # Panics
    /// Without views.
    pub fn measure(scene: &SceneData, views: &[View], renderer: &Renderer, device: &str) -> Result<Self, RenderError> {
        let Camera { width, height, .. } = views[0].camera;
        let some = views.iter().step_by(views.len().div_ceil(TIMED_VIEWS));
        let cameras: Vec<Camera> = some.map(|view| Size { width, height }.apply(&view.camera)).collect();
        let (times, device, renderer) = match check_drawn(&scene.info) {
            Ok(()) => {
                let headless = Headless::new()?;
                (scene_frame_times(&headless, scene, &cameras, ROUNDS)?, headless.adapter_name(), "raster")
            }
            Err(_) => (renderer.frame_times(&cameras, ROUNDS)?, device.to_owned(), "training"),
        };
        let FrameTimes { p50_ms, p99_ms, .. } = times;
        Ok(Self { p50: p50_ms, p99: p99_ms, device, width, height, renderer: renderer.to_owned() })
    }
}
