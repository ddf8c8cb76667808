use std::iter;
use std::sync::Arc;

use burn::tensor::Device;
use dpges_core::ranks::Ranks;
use dpges_core::scene::{Rendering, SceneInfo, ScreenFilter};
use dpges_render::Up;
use glam::Vec3;
use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;

use crate::config::{AUTOMATIC_GROWTH, Budget, Config, StagePlan, Upwards, primitives_by_pixels};
use crate::dataset::{Dataset, MOST_PREFETCHED, prefetch};
use crate::device::place::Place;
use crate::stage::TrainError;
use crate::stage::{DevicePhotographs, Stage, StepViews, Surroundings};
use crate::views::depth::DepthMaps;
use crate::views::exposure::state::ExposureState;
use crate::views::pose::PoseState;

/// State that all stages of a run share.
pub struct Context {
    /// At the size of the current stage, with the cameras of the training views where they are by now, if their poses are refined.
    pub dataset: Arc<Dataset>,
    /// The dataset as it was loaded.
    pub whole: Arc<Dataset>,
    /// Whether `dataset` is at half of its size.
    pub is_coarse: bool,
    pub config: Config,
    pub device: Device,
    /// Those that train the scene together.
    pub ranks: Arc<dyn Ranks>,
    pub rng: ChaCha8Rng,
    /// Indices of the views still to come in this pass, last first.
    pub remaining_views: Vec<u32>,
    pub completed_steps: usize,
    /// Exposures of the training views, through all stages.
    pub exposure: ExposureState,
    /// Likewise.
    pub poses: PoseState,
    /// `None` if no depth maps are learnt from.
    pub depth: Option<DepthMaps>,
    /// Photographs that stay on a GPU.
    pub photographs: DevicePhotographs,
    /// The scene around a block; `None` if the run trains all.
    pub surroundings: Option<Arc<Surroundings>>,
    /// The largest number of surfels and Gaussians together of the current stage: that of the [cameras as they were
    /// recorded](budget), wherever they have moved since.
    pub budget: usize,
    /// Of scenes that it began with, or was given since.
    pub metres_per_unit: Option<f64>,
}

impl Context {
    /// The context of a run of `config` on `dataset` before its first step, without what its stages learn beside the scene.
    pub fn new(config: Config, dataset: Arc<Dataset>, place: Place) -> Self {
        let Place { device, ranks } = place;
        let rng = ChaCha8Rng::seed_from_u64(config.train.seed);
        let photographs = DevicePhotographs::new(&config, &device);
        let budget = budget(&config, &dataset);
        Self {
            whole: Arc::clone(&dataset),
            is_coarse: false,
            dataset,
            config,
            device,
            ranks,
            rng,
            remaining_views: Vec::new(),
            completed_steps: 0,
            exposure: None,
            poses: PoseState::default(),
            depth: None,
            photographs,
            surroundings: None,
            budget,
            metres_per_unit: None,
        }
    }

    /// Brings the photographs of the training views, and the budget, to the size of the stage of `plan`.
    ///
    /// # Errors
    /// [`TrainError::Core`] if a photograph cannot be read.
    pub fn resize(&mut self, plan: &StagePlan) -> Result<(), TrainError> {
        if plan.is_coarse == self.is_coarse {
            return Ok(());
        }
        self.is_coarse = plan.is_coarse;
        self.dataset = if plan.is_coarse { Arc::new(self.whole.halved()?) } else { Arc::clone(&self.whole) };
        self.budget = budget(&self.config, &self.whole);
        if plan.is_coarse {
            // more would be finer than its pixels
            let pixels = primitives_by_pixels(different_pixels(&self.dataset));
            let automatic = if self.config.refine.budget == Budget::Auto { AUTOMATIC_GROWTH } else { 1 };
            self.budget = self.budget.min(automatic * pixels);
        }
        self.place_cameras();
        self.photographs = DevicePhotographs::new(&self.config, &self.device);
        self.depth = self.start_of_depth();
        Ok(())
    }

    /// Width or height of the largest training view of the last stage, px.
    pub fn longest_side(&self) -> usize {
        self.whole.longest_side()
    }

    /// Share of the whole run that is done.
    pub fn progress(&self) -> f64 {
        self.completed_steps as f64 / self.config.total_steps().max(1) as f64
    }

    /// The steps of the current stage, that of `plan`, that are done.
    pub fn completed_in(&self, plan: StagePlan) -> usize {
        self.completed_steps - plan.begin
    }

    /// The device that records what is done on it for a backward pass.
    pub fn tape(&self) -> Device {
        self.device.clone().autodiff()
    }

    /// Index of the next view of this pass. A pass goes over all views in random order (3DGS).
    pub fn next_view(&mut self) -> usize {
        if self.remaining_views.is_empty() {
            self.remaining_views = pass(self.dataset.train.len(), &mut self.rng);
        }
        self.remaining_views.pop().expect("a dataset has training views") as usize
    }

    /// The next views of this pass, as many as `stage` has in a step.
    pub fn next_views(&mut self, stage: &dyn Stage) -> StepViews {
        let of_ranks: Vec<usize> = (0..stage.views_per_step()).map(|_| self.next_view()).collect();
        let own = of_ranks[self.ranks.rank() % of_ranks.len()];
        StepViews { of_ranks, own }
    }

    /// Begins to read the photographs in the background that the next steps of `stage` need, if they are neither in memory nor
    /// on a GPU.
    pub fn prefetch(&self, stage: &dyn Stage) {
        let next = self.upcoming(stage.views_per_step()).take(MOST_PREFETCHED);
        let needed = next.filter(|&view| stage.looks_at_pictures() || !self.has_on_device(view));
        prefetch(needed.map(|view| &self.dataset.train[view].photograph));
    }

    /// The views of this rank in the next steps of a `batch` of views. Beyond the end of the next pass there are none, and beyond
    /// that of this one they are a guess: other random numbers may be drawn before the next one begins.
    fn upcoming(&self, batch: usize) -> impl Iterator<Item = usize> {
        let following = iter::once_with(|| pass(self.dataset.train.len(), &mut self.rng.clone()));
        let next = self.remaining_views.iter().rev().copied().chain(following.flat_map(|pass| pass.into_iter().rev()));
        next.skip(self.ranks.rank() % batch).step_by(batch).map(|view| view as usize)
    }

    pub fn scene_info(&self, rendering: Rendering) -> SceneInfo {
        let (model, dataset) = (&self.config.model, &self.dataset);
        SceneInfo {
            colour_model: model.colour,
            modulation: model.modulation,
            layer_count: model.layers,
            footprint: model.footprint,
            peeling: model.peeling,
            rendering,
            screen_filter: ScreenFilter::Compensated,
            background: dataset.background,
            offset: dataset.offset.to_array(),
            up: match self.config.data.up {
                Upwards::Auto => Up::of_cameras(dataset.train.iter().map(|view| &view.camera)),
                Upwards::Along(up) => Some(up),
            }
            .map(|up| up.direction().to_array()),
            extent: dataset.extent,
            near: dataset.near,
            metres_per_unit: self.metres_per_unit,
            ..SceneInfo::default()
        }
    }

    /// The budget whose shares stages before the joint one have. With an automatic budget that is `pixels`: views decide
    /// about growth beyond it.
    pub fn budget_before_growth(&self) -> usize {
        if self.config.refine.budget == Budget::Auto { self.budget / AUTOMATIC_GROWTH } else { self.budget }
    }

    /// The largest number of primitives of a stage that may fill `share` of the budget.
    pub fn most_primitives(&self, share: f64) -> usize {
        ((self.budget_before_growth() as f64 * share) as usize).max(1)
    }
}

/// Indices of all of `views` views in random order.
fn pass(views: usize, rng: &mut ChaCha8Rng) -> Vec<u32> {
    let mut order: Vec<u32> = (0..views as u32).collect();
    order.shuffle(rng);
    order
}

/// Most points of a dataset that are looked up in its views to find how much these share.
const SAMPLED_POINTS: usize = 2000;
/// Largest number of pictures without anything in common that a budget is made for.
const MOST_PICTURES: f64 = 4.0;

/// The largest number of surfels and Gaussians together that a run of `config` on `dataset` may have.
pub fn budget(config: &Config, dataset: &Dataset) -> usize {
    config.most_primitives(different_pixels(dataset))
}

/// Number of pixels of pictures without anything in common that show as much as the training views do.
fn different_pixels(dataset: &Dataset) -> usize {
    (mean_pixels(dataset) as f64 * different_pictures(dataset)) as usize
}

/// How many pictures without anything in common show as much as the training views do, from 1 to [`MOST_PICTURES`]: the
/// number of views over the mean number of views that have a point of the dataset in their pictures. 1 without points.
fn different_pictures(dataset: &Dataset) -> f64 {
    let points = &dataset.points.positions;
    let sample = points.iter().step_by(points.len().div_ceil(SAMPLED_POINTS).max(1));
    let views_of = |point: &[f32; 3]| {
        let world = Vec3::from_array(*point).as_dvec3();
        dataset.train.iter().filter(|view| view.camera.pixel(world).is_some()).count()
    };
    let counts: Vec<usize> = sample.map(views_of).filter(|&views| views > 0).collect();
    let views = counts.iter().sum::<usize>() as f64;
    if counts.is_empty() { 1.0 } else { (dataset.train.len() * counts.len()) as f64 / views }.clamp(1.0, MOST_PICTURES)
}

/// Mean number of pixels of a training view.
pub fn mean_pixels(dataset: &Dataset) -> usize {
    let pixels: usize = dataset.train.iter().map(|view| view.camera.width * view.camera.height).sum();
    pixels / dataset.train.len().max(1)
}

#[cfg(test)]
mod tests {
    use dpges_core::camera::{Camera, CameraFromWorld};
    use dpges_core::testing::ranks::on_ranks;
    use glam::DVec3;

    use super::*;
    use crate::dataset::{BuiltinOptions, Tracks, View, builtin};

    /// The built-in scene with `views`, each a camera at the origin that looks along x turned about y, rad.
    fn looking(turns: &[f64], points: Vec<[f32; 3]>) -> Dataset {
        let mut dataset = builtin(&BuiltinOptions { width: 8, height: 8, train_views: 2, ..Default::default() });
        let view = dataset.train[0].clone();
        let camera = |turn: f64| {
            let at = DVec3::new(turn.cos(), 0.0, turn.sin());
            Camera { camera_from_world: CameraFromWorld::look_at(DVec3::ZERO, at, -DVec3::Y), ..view.camera }
        };
        dataset.train = turns.iter().map(|&turn| View { camera: camera(turn), ..view.clone() }).collect();
        dataset.points.seen_by = Tracks::default();
        dataset.points.positions = points;
        dataset
    }

    #[test]
    fn what_is_read_ahead_is_what_comes_next() {
        let upcoming = on_ranks(2, |ranks| {
            let own = ranks.rank();
            let place = Place { device: Device::flex(), ranks };
            let mut context = Context::new(Config::default(), Arc::new(looking(&[0.0; 5], Vec::new())), place);
            context.next_view();
            let expected: Vec<usize> = context.upcoming(2).take(4).collect();
            let mut next = || [context.next_view(), context.next_view()];
            let found: Vec<usize> = (0..4).map(|_| next()[own]).collect();
            assert_eq!(expected, found);
            found
        });
        assert_ne!(upcoming[0], upcoming[1]);
    }

    #[test]
    fn views_of_the_same_count_once_and_others_as_often_as_they_differ() {
        let (ahead, behind) = ([2.0, 0.0, 0.0], [-2.0, 0.0, 0.0]);
        let half_turn = std::f64::consts::PI;
        let pictures = |turns: &[f64], points: &[[f32; 3]]| different_pictures(&looking(turns, points.to_vec()));
        assert_eq!(pictures(&[0.0, 0.0, 0.0], &[ahead]), 1.0);
        assert_eq!(pictures(&[0.0, half_turn], &[ahead, behind]), 2.0);
        assert_eq!(pictures(&[0.0, 0.0, half_turn, half_turn], &[ahead, behind, [0.0, 9.0, 0.0]]), 2.0);
        assert_eq!(pictures(&[0.0, 1.5, 3.0, 4.5, 1.0, 2.0], &[ahead]), 4.0);
        assert_eq!(pictures(&[0.0, half_turn], &[]), 1.0);
        let (one, two) = (looking(&[0.0], vec![ahead]), looking(&[0.0, half_turn], vec![ahead, behind]));
        let pixels = mean_pixels(&one);
        let config = Config::default();
        assert_eq!(budget(&config, &one), config.most_primitives(pixels));
        assert_eq!(budget(&config, &two), config.most_primitives(2 * pixels));
    }
}
