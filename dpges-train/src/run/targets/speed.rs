//! The budget with which the real-time renderer is fast enough.

use std::sync::Arc;

use burn::tensor::Device;
use dpges_core::camera::Camera;
use dpges_core::scene::SceneData;
use dpges_render::frame_times::{Rounds, scene_frame_times};
use dpges_render::path::Size;
use dpges_render::{Headless, RenderError, check_drawn_as_trained};

use super::{TargetError, TargetPlan, Unit};
use crate::config::{Budget, Config};
use crate::dataset::{BuiltinOptions, Dataset, builtin};
use crate::run::{TrainError, Trainer, budget};

/// Fewer primitives show nothing.
const FEWEST: usize = 100;

/// Points of the built-in scenes that are drawn; each becomes a surfel and a Gaussian, or a Gaussian alone.
const POINTS: [usize; 2] = [15_000, 60_000];
const CAMERAS: usize = 4;
const ROUNDS: Rounds = Rounds { warm_up: 1, counted: 5 };

/// Time of a frame: linear in the number of primitives.
#[derive(Clone, Copy, Debug, PartialEq)]
struct FrameModel {
    /// ms
    rest: f64,
    /// ms
    per_primitive: f64,
}

impl FrameModel {
    /// Through two measurements (primitives, ms). If the larger scene took no longer, the time is put down to the primitives
    /// alone: that asks too few of them rather than too many.
    fn through([(few, of_few), (many, of_many)]: [(usize, f64); 2]) -> Self {
        let slope = (of_many - of_few) / (many as f64 - few as f64);
        let rest = of_few - slope * few as f64;
        if slope.is_finite() && slope > 0.0 && rest >= 0.0 {
            Self { rest, per_primitive: slope }
        } else {
            Self { rest: 0.0, per_primitive: of_many / many.max(1) as f64 }
        }
    }

    fn ms(&self, primitives: usize) -> f64 {
        self.rest + self.per_primitive * primitives as f64
    }

    fn primitives_within(&self, ms: f64) -> usize {
        ((ms - self.rest) / self.per_primitive).max(0.0) as usize
    }
}

/// Sets `refine.budget` to what is drawn `asked` times a second at the size of the training views, but not above what the
/// budget of `config` allows. Two built-in scenes are measured as a run of `config` begins with them.
pub(super) fn plan(
    asked: String,
    config: &mut Config,
    dataset: &Dataset,
    device: &Device,
    rate: f64,
) -> Result<TargetPlan, TargetError> {
    let headless = Headless::new().map_err(TargetError::NoAdapter)?;
    let size = size_of(dataset);
    let mut measured = [(0, 0.0); 2];
    for (points, measured) in POINTS.into_iter().zip(&mut measured) {
        let (scene, cameras) = builtin_scene(config, points, size, device)?;
        *measured = (scene.surfels.len() + scene.gaussians.len(), median_ms(&headless, &scene, &cameras)?);
    }
    let model = FrameModel::through(measured);
    let (fitting, allowed) = (model.primitives_within(1e3 / rate), budget(config, dataset));
    let Size { width, height } = size;
    if fitting < FEWEST {
        let fastest = 1e3 / model.ms(FEWEST);
        return Err(TargetError::TooFast { adapter: headless.adapter_name(), width, height, fastest });
    }
    let count = fitting.min(allowed);
    config.refine.budget = Budget::Primitives(count);
    let how = format!(
        "at most {count} primitives at {width}x{height} px on {}: {:.2} ms and {:.3} ms per 10,000",
        headless.adapter_name(),
        model.rest,
        1e4 * model.per_primitive
    );
    let expected = 1e3 / model.ms(count);
    let step = dataset.train.len().div_ceil(CAMERAS).max(1);
    let cameras = dataset.train.iter().step_by(step).map(|view| size.apply(&view.camera)).collect();
    Ok(TargetPlan { asked, unit: Unit::FramesPerSecond, expected, how, cameras })
}

/// Frames per second of `scene` from `cameras`, by the median time.
pub(super) fn frames_per_second(scene: &SceneData, cameras: &[Camera]) -> Result<f64, RenderError> {
    Ok(1e3 / median_ms(&Headless::new()?, scene, cameras)?)
}

fn median_ms(headless: &Headless, scene: &SceneData, cameras: &[Camera]) -> Result<f64, RenderError> {
    check_drawn_as_trained(&scene.info)?;
    Ok(scene_frame_times(headless, scene, cameras, ROUNDS)?.p50_ms)
}

/// The largest width and height of the training views.
fn size_of(dataset: &Dataset) -> Size {
    let largest = |of: fn(&Camera) -> usize| dataset.train.iter().map(|view| of(&view.camera)).max().unwrap_or(1);
    Size { width: largest(|camera| camera.width), height: largest(|camera| camera.height) }
}

/// The first scene of a run with the model and the method of `config` in a room of so many points, and cameras in it.
fn builtin_scene(
    config: &Config,
    points: usize,
    size: Size,
    device: &Device,
) -> Result<(SceneData, Vec<Camera>), TrainError> {
    let options =
        BuiltinOptions { width: 16, height: 16, train_views: CAMERAS, test_views: 0, points, ..Default::default() };
    let dataset = builtin(&options);
    let cameras = dataset.train.iter().map(|view| size.apply(&view.camera)).collect();
    let mut begin = Config { model: config.model.clone(), ..Config::default() };
    begin.train.method = config.train.method;
    begin.init.max_points = points;
    begin.stages.gaussians = 0.0;
    // room for all of them: a run begins with a part of its budget
    begin.refine.budget = Budget::Primitives(4 * points);
    let scene = Trainer::new(begin, Arc::new(dataset), device.clone())?.scene();
    Ok((scene, cameras))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::run::fixtures::device;

    #[test]
    fn frame_times_are_linear_in_the_primitives() {
        let model = FrameModel::through([(10_000, 3.0), (30_000, 5.0)]);
        assert_eq!((model.rest, model.primitives_within(4.0)), (2.0, 20_000));
        assert_eq!(model.primitives_within(1.5), 0);
        assert!((model.ms(50_000) - 7.0).abs() < 1e-9);
        for pair in [[(10_000, 3.0), (30_000, 3.0)], [(10_000, 3.0), (30_000, 2.0)], [(10_000, 0.1), (30_000, 5.0)]] {
            let model = FrameModel::through(pair);
            assert_eq!(model.rest, 0.0);
            assert!((model.ms(30_000) - pair[1].1).abs() < 1e-9, "{model:?}");
        }
    }

    #[test]
    fn scenes_of_two_sizes_are_made_of_points() {
        let size = Size { width: 40, height: 20 };
        let made = |points: usize| builtin_scene(&Config::default(), points, size, &device()).unwrap();
        let [(few, cameras), (many, _)] = [300, 900].map(made);
        let count = |scene: &SceneData| scene.surfels.len() + scene.gaussians.len();
        assert!(count(&few) > 300 && count(&many) > 2 * count(&few), "{} and {}", count(&few), count(&many));
        assert!(cameras.len() == CAMERAS && cameras.iter().all(|camera| (camera.width, camera.height) == (40, 20)));
    }
}
