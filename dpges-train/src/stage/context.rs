//! What all stages of a run share.

use std::sync::Arc;

use burn::tensor::Device;
use dpges_core::scene::{Rendering, SceneInfo, ScreenFilter};
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;

use crate::config::{Config, StagePlan};
use crate::dataset::Dataset;

/// What all stages of a run share.
pub struct Context {
    pub dataset: Arc<Dataset>,
    pub config: Config,
    pub device: Device,
    pub rng: ChaCha8Rng,
    /// Indices of the views still to come in this pass, last first.
    pub remaining_views: Vec<u32>,
    /// Of the whole run.
    pub completed_steps: usize,
}

impl Context {
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
            self.remaining_views = (0..self.dataset.train.len() as u32).collect();
            self.remaining_views.shuffle(&mut self.rng);
        }
        self.remaining_views.pop().expect("a dataset has training views") as usize
    }

    /// Begins a new pass. A stage does so at its start, since its schedule counts passes from there.
    pub fn begin_pass(&mut self) {
        self.remaining_views.clear();
    }

    /// The metadata of the scenes of this run.
    pub fn scene_info(&self, rendering: Rendering) -> SceneInfo {
        let (model, dataset) = (&self.config.model, &self.dataset);
        SceneInfo {
            colour_model: model.colour,
            modulation: model.modulation,
            layer_count: model.layers,
            footprint: model.footprint,
            margin_lookup: model.margin_lookup,
            rendering,
            screen_filter: ScreenFilter::Compensated,
            background: dataset.background,
            offset: dataset.offset.to_array(),
            extent: dataset.extent,
            near: dataset.near,
        }
    }

    /// The largest number of surfels and Gaussians together.
    pub fn budget(&self) -> usize {
        budget(&self.config, &self.dataset)
    }

    /// The largest number of primitives of a stage that may fill `share` of the budget.
    pub fn most_primitives(&self, share: f64) -> usize {
        ((self.budget() as f64 * share) as usize).max(1)
    }
}

/// The largest number of surfels and Gaussians together that a run of `config` on `dataset` may have.
pub fn budget(config: &Config, dataset: &Dataset) -> usize {
    config.most_primitives(mean_pixels(dataset))
}

/// Mean number of pixels of a training view.
pub fn mean_pixels(dataset: &Dataset) -> usize {
    let pixels: usize = dataset.train.iter().map(|view| view.picture.width * view.picture.height).sum();
    pixels / dataset.train.len().max(1)
}
