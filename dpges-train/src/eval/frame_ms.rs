//! Frame times of a scene, as its evaluation reports them.

use dpges_core::camera::Camera;
use dpges_core::scene::SceneData;
use dpges_render::frame_times::{FrameTimes, Rounds, scene_frame_times};
use dpges_render::path::Size;
use dpges_render::{Headless, RenderError, check_drawn_as_trained};
use serde::{Deserialize, Serialize};

use super::rendered::TrainingRenderer;
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

/// Times of `scene` from `cameras`, and the name of the adapter: in real time if `headless`, or else by `renderer`, that of
/// training, which draws all scenes as they were trained. No name means the latter.
///
/// # Errors
/// Those of `headless`, which only scenes need that are drawn in real time; [`RenderError`] if a renderer refuses the cameras.
pub fn frame_times_as_trained(
    scene: &SceneData,
    cameras: &[Camera],
    rounds: Rounds,
    headless: impl FnOnce() -> Result<Headless, RenderError>,
    renderer: &TrainingRenderer,
) -> Result<(FrameTimes, Option<String>), RenderError> {
    if check_drawn_as_trained(&scene.info).is_err() {
        return Ok((renderer.frame_times(cameras, rounds)?, None));
    }
    let headless = headless()?;
    Ok((scene_frame_times(&headless, scene, cameras, rounds)?, Some(headless.adapter_name())))
}

impl FrameMs {
    /// Times of `scene` as [`frame_times_as_trained`], from some of `views`, at the size of the first; `renderer` is on the
    /// `device` that is called so.
    ///
    /// # Errors
    /// [`RenderError`] without an adapter, or if a renderer refuses the scene or the cameras.
    ///
    /// # Panics
    /// Without views.
    pub fn measure(
        scene: &SceneData,
        views: &[View],
        renderer: &TrainingRenderer,
        device: &str,
    ) -> Result<Self, RenderError> {
        let Camera { width, height, .. } = views[0].camera;
        let some = views.iter().step_by(views.len().div_ceil(TIMED_VIEWS));
        let cameras: Vec<Camera> = some.map(|view| Size { width, height }.apply(&view.camera)).collect();
        let (times, adapter) = frame_times_as_trained(scene, &cameras, ROUNDS, Headless::new, renderer)?;
        let (device, renderer) = adapter.map_or((device.to_owned(), "training"), |adapter| (adapter, "raster"));
        let FrameTimes { p50_ms, p99_ms, .. } = times;
        Ok(Self { p50: p50_ms, p99: p99_ms, device, width, height, renderer: renderer.to_owned() })
    }
}

#[cfg(test)]
mod tests {
    use dpges_core::scene::{BlendOrder, ColourModel, GaussianData, Rendering, SceneInfo, SurfelData, Transparency};

    use super::*;
    use crate::dataset::{BuiltinOptions, builtin};
    use crate::run::fixtures::device;

    #[test]
    fn scenes_that_are_sorted_otherwise_in_real_time_are_timed_as_they_were_trained() {
        let model = ColourModel::SphericalBeta { lobes: 0 };
        let options = BuiltinOptions { width: 8, height: 8, train_views: 1, test_views: 1, ..Default::default() };
        let camera = builtin(&options).train[0].camera;
        let times = |blend_order: BlendOrder| {
            let info = SceneInfo {
                colour_model: model,
                rendering: Rendering::Ellipsoids,
                blend_order,
                ..SceneInfo::default()
            };
            let surfels = SurfelData::neutral(model, 0);
            let scene = SceneData { info, surfels, gaussians: GaussianData::neutral(model, 1), environment: None };
            let (rounds, renderer) = (Rounds { warm_up: 1, counted: 3 }, TrainingRenderer::new(&scene, &device()));
            let headless = || Err(RenderError::NoAdapter("none is asked for".to_owned()));
            frame_times_as_trained(&scene, &[camera], rounds, headless, &renderer)
        };
        for order in [BlendOrder::Rays, BlendOrder::Whitened(Transparency::Hybrid)] {
            let (times, adapter) = times(order).unwrap();
            assert_eq!((times.frames, adapter), (3, None), "{order}");
        }
        assert!(matches!(times(BlendOrder::Centres), Err(RenderError::NoAdapter(_))));
    }
}
