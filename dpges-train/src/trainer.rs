//! The joint optimisation of surfels and Gaussians (DP-GES): one view per step.

mod pending;
mod refinement;
mod resume;
mod statistics;

use std::sync::Arc;

use burn::tensor::{DType, Device, Tensor, TensorData};
use dpges_core::device::{fix_order_of_sums, is_gpu};
use dpges_core::losses::{LossWeights, losses};
use dpges_core::ops::adam::AdamStep;
use dpges_core::ops::finite::FiniteChecks;
use dpges_core::render::{RenderOptions, Values, render_values};
use dpges_core::scene::{SceneData, SceneInfo};
use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;

use crate::config::{Config, Due, Schedule};
use crate::dataset::{Dataset, View};
use crate::init::{InitError, initialise};
use crate::scene_state::{GaussianState, Rates, SurfelState};
use pending::PendingStep;
use statistics::Statistics;

#[derive(Debug, thiserror::Error)]
pub enum TrainError {
    #[error("initialisation: {0}")]
    Init(#[from] InitError),
    #[error("step {step}, view `{view}`: {source}; the step was not taken")]
    Step { step: usize, view: String, source: dpges_core::Error },
    #[error("step {step}, view `{view}`: the loss is {loss}; the step was not taken")]
    Loss { step: usize, view: String, loss: f64 },
    #[error("step {step}: the device failed: {reason}")]
    Device { step: usize, reason: String },
    #[error(transparent)]
    Core(#[from] dpges_core::Error),
    #[error("the checkpoint does not fit: {reason}")]
    Resume { reason: String },
}

/// What one step did.
#[derive(Clone, Debug, PartialEq)]
pub struct StepReport {
    /// Completed steps, this one included.
    pub step: usize,
    /// Index of the training view.
    pub view: usize,
    /// Weighted sum of the terms.
    pub loss: f64,
    pub rgb: f64,
    pub surfel: f64,
    pub scale: f64,
    pub transmittance: f64,
    /// dB of the training view before the step, clamped and not quantised.
    pub psnr: f64,
    pub surfels: usize,
    pub gaussians: usize,
    /// What refinement did before the step.
    pub events: Vec<String>,
}

impl StepReport {
    /// Before the numbers are known.
    fn begin(step: usize, view: usize, surfels: usize, gaussians: usize, events: Vec<String>) -> Self {
        let unknown = f64::NAN;
        Self {
            step,
            view,
            loss: unknown,
            rgb: unknown,
            surfel: unknown,
            scale: unknown,
            transmittance: unknown,
            psnr: unknown,
            surfels,
            gaussians,
            events,
        }
    }
}

/// A run: a dataset, a scene that learns it, and where in the schedule it stands.
pub struct Trainer {
    dataset: Arc<Dataset>,
    config: Config,
    device: Device,
    info: SceneInfo,
    schedule: Schedule,
    surfels: SurfelState,
    gaussians: GaussianState,
    statistics: Statistics,
    rng: ChaCha8Rng,
    /// Views still to come in this pass, last first.
    remaining_views: Vec<u32>,
    completed_steps: usize,
    /// A GPU works on this step while the host prepares the next.
    pending: Option<PendingStep>,
}

impl Trainer {
    /// A run before its first step.
    ///
    /// # Errors
    /// [`TrainError::Init`] if the dataset has nothing to start from.
    pub fn new(dataset: Arc<Dataset>, mut config: Config, device: Device) -> Result<Self, TrainError> {
        config.refine.fix_budget(mean_pixels(&dataset));
        if config.train.deterministic {
            fix_order_of_sums();
        }
        let mut rng = ChaCha8Rng::seed_from_u64(config.train.seed);
        let start = initialise(&dataset, &config, &mut rng)?;
        let model = config.model.colour;
        Ok(Self {
            info: scene_info(&dataset, &config),
            schedule: config.schedule(dataset.train.len()),
            surfels: SurfelState::new(&start.surfels, model, &device),
            gaussians: GaussianState::new(&start.gaussians, model, &device),
            statistics: Statistics::new(start.surfels.len(), start.gaussians.len(), &device),
            rng,
            remaining_views: Vec::new(),
            completed_steps: 0,
            pending: None,
            dataset,
            config,
            device,
        })
    }

    /// As given, with everything automatic decided.
    pub fn config(&self) -> &Config {
        &self.config
    }

    pub fn completed_steps(&self) -> usize {
        self.completed_steps
    }

    pub fn is_finished(&self) -> bool {
        self.completed_steps >= self.config.train.steps
    }

    /// The scene as it stands.
    pub fn scene(&self) -> SceneData {
        SceneData { info: self.info.clone(), surfels: self.surfels.to_data(), gaussians: self.gaussians.to_data() }
    }

    /// Whatever refinement is due, then one optimisation step on the next view.
    ///
    /// In this order, since a scene is at its worst right after Gaussians were added: between two steps,
    /// when it is evaluated and saved, it has been optimised since.
    ///
    /// Returns the report of this step on a CPU. A GPU is still working on this step: there it is the
    /// report of the step before, if [`settle`](Self::settle) has not given it away.
    ///
    /// # Errors
    /// [`TrainError::Step`] or [`TrainError::Loss`] if the loss or a gradient was not finite; that step
    /// then changed nothing.
    pub fn step(&mut self) -> Result<Option<StepReport>, TrainError> {
        let due = self.schedule.due(self.completed_steps);
        let mut known = None;
        if due != Due::default() {
            known = self.settle()?;
        }
        let events = self.refine(due)?;
        let before = self.pending.take();
        self.pending = Some(self.begin_step(events)?);
        self.completed_steps += 1;
        if !is_gpu(&self.device) {
            return self.settle();
        }
        if let Some(before) = before {
            known = Some(before.settle()?);
        }
        Ok(known)
    }

    /// Waits for the step that the device is working on and returns its report, if there is one.
    ///
    /// # Errors
    /// Those of [`step`](Self::step).
    pub fn settle(&mut self) -> Result<Option<StepReport>, TrainError> {
        self.pending.take().map(PendingStep::settle).transpose()
    }

    /// Hands everything of one step to the device.
    fn begin_step(&mut self, events: Vec<String>) -> Result<PendingStep, TrainError> {
        let view = self.next_view();
        let dataset = Arc::clone(&self.dataset);
        let picture = &dataset.train[view];
        let step = self.completed_steps + 1;
        let at = |source| TrainError::Step { step, view: picture.name.clone(), source };

        let surfels = self.surfels.leaves();
        let (gaussians, opacities) = self.gaussians.leaves();
        let target = target(picture, &self.device.clone().autodiff());
        // afterwards they stay finite, since steps with a gradient that is not are held back
        let known = if self.completed_steps == 0 { Values::Unknown } else { Values::KnownFinite };
        let options = self.render_options();
        let rendered = render_values(&surfels, &gaussians, &picture.camera, &options, known).map_err(at)?;
        let terms = losses(&rendered, surfels.log_scales.clone(), target.clone(), &self.loss_weights()).map_err(at)?;
        let report = StepReport::begin(step, view, self.surfels.len(), self.gaussians.len(), events);

        let mut gradients = terms.total.backward();
        let surfel_gradients = self.surfels.gradients(&surfels, &mut gradients);
        let gaussian_gradients = self.gaussians.gradients((&gaussians, &opacities), &mut gradients);
        let mut checks = FiniteChecks::default();
        checks.add("loss", &terms.total.clone().inner());
        let names = SurfelState::NAMES.into_iter().chain(GaussianState::NAMES);
        for (name, gradient) in names.zip(surfel_gradients.iter().chain(&gaussian_gradients)) {
            if let Some(gradient) = gradient {
                checks.add(format!("gradient of {name}"), gradient);
            }
        }
        let bad = checks.positions().greater_equal_elem(0).float().sum();
        let gate = bad.clone().clamp_max(1.0) * -1.0 + 1.0;
        let view_name = picture.name.clone();
        let pending = PendingStep::new(report, view_name, &terms, &rendered, target, checks, bad);
        self.statistics.observe(&rendered, &self.gaussians, &picture.camera, &self.schedule, self.completed_steps)?;
        // the tape shares the parameters: without it the optimiser can work in place
        drop((surfels, gaussians, opacities, rendered, terms));

        let (rates, adam) = self.rates();
        let surfel_rates = if self.config.train.freeze_surfels { rates.of_frozen_surfels() } else { rates };
        self.surfels.step(surfel_gradients, &gate, &surfel_rates, adam)?;
        self.gaussians.step(gaussian_gradients, &gate, &rates, adam)?;
        Ok(pending)
    }

    /// The next view of this pass; passes go over all views in random order (3DGS).
    fn next_view(&mut self) -> usize {
        if self.remaining_views.is_empty() {
            self.remaining_views = (0..self.dataset.train.len() as u32).collect();
            self.remaining_views.shuffle(&mut self.rng);
        }
        self.remaining_views.pop().expect("a dataset has training views") as usize
    }

    fn render_options(&self) -> RenderOptions {
        RenderOptions {
            detach_transmittance: self.config.train.detach_transmittance,
            ..RenderOptions::from(&self.info)
        }
    }

    fn loss_weights(&self) -> LossWeights {
        let train = &self.config.train;
        LossWeights {
            dssim: train.lambda_dssim,
            surfel: train.lambda_surfel,
            scale: train.lambda_scale,
            transmittance: train.lambda_transmittance,
        }
    }

    /// Learning rates of the coming step, and Adam's other constants.
    fn rates(&self) -> (Rates, AdamStep) {
        let optimizer = &self.config.optimizer;
        let progress = self.completed_steps as f64 / self.config.train.steps as f64;
        let (position, decay) = (optimizer.position_rate(progress, self.info.extent), optimizer.decay_at(progress));
        let rates = Rates {
            surfel_positions: position * optimizer.surfel_position_factor,
            gaussian_positions: position,
            quaternions: optimizer.quaternions * decay,
            log_scales: optimizer.log_scales * decay,
            opacities: optimizer.opacities * decay,
            base: optimizer.base * decay,
            detail: optimizer.detail * decay,
        };
        let adam = AdamStep {
            learning_rate: 0.0,
            beta_1: optimizer.beta1,
            beta_2: optimizer.beta2,
            epsilon: optimizer.epsilon,
            time: self.completed_steps as u64 + 1,
        };
        (rates, adam)
    }
}

/// What the scene file of a run on `dataset` says besides its tensors.
fn scene_info(dataset: &Dataset, config: &Config) -> SceneInfo {
    let model = &config.model;
    SceneInfo {
        colour_model: model.colour,
        modulation: model.modulation,
        layer_count: model.layers,
        footprint: model.footprint,
        margin_lookup: model.margin_lookup,
        background: dataset.background,
        offset: dataset.offset.to_array(),
        extent: dataset.extent,
        near: dataset.near,
    }
}

/// Pixels of a training view, on average.
fn mean_pixels(dataset: &Dataset) -> usize {
    let pixels: usize = dataset.train.iter().map(|view| view.picture.width * view.picture.height).sum();
    pixels / dataset.train.len().max(1)
}

/// [3, H, W] picture of a view.
fn target(view: &View, device: &Device) -> Tensor<3> {
    let picture = &view.picture;
    let data = TensorData::new(picture.planes.clone(), [3, picture.height, picture.width]);
    Tensor::from_data(data, (device, DType::F32))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dataset::{BuiltinOptions, builtin};
    use crate::device::DeviceName;

    #[test]
    fn frozen_surfels_learn_nothing_but_colours() {
        let options =
            BuiltinOptions { width: 24, height: 24, train_views: 3, test_views: 1, points: 200, ..Default::default() };
        let set = ["train.steps=9", "train.freeze_surfels=true"].map(str::to_owned);
        let config = Config::resolve(None, None, &set).unwrap();
        let device = "cpu".parse::<DeviceName>().unwrap().open().unwrap();
        let mut trainer = Trainer::new(Arc::new(builtin(&options)), config, device).unwrap();
        let before = trainer.scene();
        while !trainer.is_finished() {
            trainer.step().unwrap();
        }
        let after = trainer.scene();
        assert!(!before.surfels.is_empty());
        assert_eq!(after.surfels.positions, before.surfels.positions);
        assert_eq!(after.surfels.quaternions, before.surfels.quaternions);
        assert_eq!(after.surfels.log_scales, before.surfels.log_scales);
        assert_ne!(after.surfels.colour, before.surfels.colour);
        assert_ne!(after.gaussians.positions, before.gaussians.positions);
    }
}
