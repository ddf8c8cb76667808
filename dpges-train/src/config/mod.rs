//! The configuration of a run. `keys.rs` declares every key once: its meaning, default, unit, range and ablations.
//!
//! | module | for |
//! |---|---|
//! | [`mod@keys`] | the declarations |
//! | [`declare`] | the macro that they are written in, and what it makes of them |
//! | [`choices`], [`budget`], [`memory`] | types of values |
//! | [`range`] | which numbers make sense |
//! | [`sources`] | defaults, presets, files and options, one over the other |
//! | [`document`] | the keys as TOML and Markdown |
//! | [`stages`], [`schedule`] | the stages of a run, and the steps at which the set of primitives changes |

pub mod budget;
pub mod choices;
pub mod declare;
mod differences;
pub mod document;
pub mod keys;
pub mod memory;
pub mod range;
pub mod schedule;
pub mod sources;
pub mod stages;

use std::f64::consts::PI;

use dpges_core::ops::adam::AdamStep;

use crate::dataset::{DepthKind, LoadOptions};
use crate::views::pose::step::PoseStep;

pub use budget::Budget;
use budget::{MEGABYTE, primitives_for};
pub use choices::{
    Alpha, Background, BuiltinLens, DepthMaps, Environment, Exposure, GaussianStage, InitMethod, JointOpacity, Margin,
    Method, NewGaussians, PixelsOf, Poses, SfmCamera, SfmMatching, SfmProgram, Stop, SurfelStart,
};
pub use declare::{Ablation, Key, Section};
pub use differences::differences;
pub use dpges_core::scene::OpacityActivation;
pub use keys::{
    Config, DataConfig, DensityConfig, DiscsConfig, InitConfig, ModelConfig, OptimizerConfig, RefineConfig,
    RelocationConfig, SECTIONS, StagesConfig, TrainConfig,
};
pub use memory::Memory;
pub use schedule::{Due, Schedule};
pub use sources::ConfigError;
pub use stages::{Blended, Density, Relocation, StageKind, StagePlan};

/// Modulation at which rims of surfels are as hard as those of GES.
pub const HARD_RIM: f64 = 255.0;
/// Smallest budget by the size of the views, in primitives: even a small picture shows a whole scene.
pub const SMALLEST_BUDGET_BY_PIXELS: usize = 16_384;
/// Share of surfels for which a budget in megabytes is converted into primitives. Surfels and Gaussians differ by 4 %.
const SURFEL_SHARE: f64 = 0.1;
/// Factor on the learning rate of colour corrections at the last step.
const EXPOSURE_DECAY: f64 = 0.1;
/// Share of the run over which the learning rates of poses rise from 0.
const POSE_RISE: f64 = 0.1;
/// Decay of both of Adam's means for poses, each time that a view is seen, which is some dozens of times.
const POSE_BETA: f64 = 0.9;
/// Every how many-th training view is kept for validation by default.
const DEFAULT_VALIDATION_EVERY: usize = 8;

/// All keys, in the order in which they are documented.
pub fn keys() -> impl Iterator<Item = &'static Key> {
    SECTIONS.iter().flat_map(|section| section.keys)
}

/// The key called `name`, such as `train.steps`.
///
/// # Panics
/// If there is none.
pub fn key(name: &str) -> &'static Key {
    keys().find(|key| key.name == name).unwrap_or_else(|| panic!("no key `{name}` is declared"))
}

impl Config {
    /// Largest number of surfels and Gaussians together for training views of `pixels` px. An automatic budget is
    /// limited to twice the budget `pixels`.
    pub fn most_primitives(&self, pixels: usize) -> usize {
        let by_pixels = (pixels / 2).max(SMALLEST_BUDGET_BY_PIXELS);
        match self.refine.budget {
            Budget::Pixels => by_pixels,
            Budget::Auto => 2 * by_pixels,
            Budget::Primitives(count) => count,
            Budget::Megabytes(size) => primitives_for(MEGABYTE * size, self.model.colour, SURFEL_SHARE).max(1),
        }
    }

    /// Every how many-th training view is kept for validation; 0: none.
    pub fn validation_every(&self) -> usize {
        let decides = self.train.stop == Stop::Validation || self.refine.budget == Budget::Auto;
        match self.data.validation_every {
            0 if decides => DEFAULT_VALIDATION_EVERY,
            every => every,
        }
    }
}

impl DataConfig {
    pub fn load_options(&self) -> LoadOptions {
        LoadOptions {
            background: match self.background {
                Background::Auto => None,
                Background::Colour(colour) => Some(colour),
            },
            image_scale: (self.image_scale > 1).then_some(self.image_scale),
            max_resolution: (self.max_resolution > 0).then_some(self.max_resolution),
            test_every: self.test_every,
            undistort: self.undistort,
            near: (self.near > 0.0).then_some(self.near),
            alpha_masks: self.alpha == Alpha::Mask,
            invert_masks: self.invert_masks,
            memory: self.memory.bytes(),
            depth: match self.depth {
                DepthMaps::None => None,
                DepthMaps::Metric => Some(DepthKind::Metric),
                DepthMaps::Relative => Some(DepthKind::Relative),
            },
        }
    }
}

impl TrainConfig {
    /// Weight of the loss of depth maps at `progress` of the whole run. Its logarithm is linear in `progress`.
    pub fn depth_map_weight(&self, progress: f64) -> f64 {
        self.lambda_depth_maps * between(1.0, self.depth_maps_decay, progress)
    }

    /// Whether a loss compares surfels with discs.
    pub fn has_geometry_losses(&self) -> bool {
        self.lambda_depth > 0.0 || self.lambda_normal > 0.0 || self.lambda_depth_normal > 0.0
    }
}

impl OptimizerConfig {
    /// Adam's constants for the step after `completed` steps, without a learning rate.
    pub fn adam(&self, completed: usize) -> AdamStep {
        AdamStep {
            learning_rate: 0.0,
            beta_1: self.beta1,
            beta_2: self.beta2,
            epsilon: self.epsilon,
            time: completed as u64 + 1,
        }
    }

    /// Learning rate of Gaussian positions in world units at `progress` (0 at the first step, 1 at the last) for a scene
    /// of `extent` (world units). Its logarithm is linear in `progress` (3DGS).
    pub fn position_rate(&self, progress: f64, extent: f64) -> f64 {
        extent * between(self.position_start, self.position_end, progress)
    }

    /// Learning rate of colour corrections at `progress` of the whole run. Its logarithm is linear in `progress`.
    pub fn exposure_rate(&self, progress: f64) -> f64 {
        self.exposure * between(1.0, EXPOSURE_DECAY, progress)
    }

    /// Whether poses are learnt at `progress` of the whole run: before, the scene is too coarse to say where cameras are.
    pub fn poses_are_learnt(&self, progress: f64) -> bool {
        progress >= self.pose_from
    }

    /// The step of a pose after `completed` of `steps` of the whole run, for a scene of `extent` (world units). Rates rise from
    /// 0 where they begin, and fall to 0 as half a wave of a cosine.
    pub fn pose_step(&self, completed: usize, steps: usize, extent: f64) -> PoseStep {
        let since = (completed as f64 / steps.max(1) as f64 - self.pose_from).max(0.0);
        let fall = 0.5 + 0.5 * (PI * (since / (1.0 - self.pose_from)).min(1.0)).cos();
        let factor = (since / POSE_RISE).min(1.0) * fall;
        PoseStep {
            rotation: self.pose_rotation * factor,
            translation: self.pose_translation * factor,
            extent,
            adam: AdamStep { beta_1: POSE_BETA, beta_2: POSE_BETA, ..self.adam(completed) },
        }
    }

    /// Factor on every other learning rate at `progress` of the last stage.
    pub fn decay_at(&self, progress: f64) -> f64 {
        between(1.0, self.decay, (progress - self.decay_from) / (1.0 - self.decay_from))
    }
}

fn between(start: f64, end: f64, progress: f64) -> f64 {
    start * (end / start).powf(progress.clamp(0.0, 1.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rates_start_and_end_where_they_should() {
        let rates = OptimizerConfig { decay: 0.01, decay_from: 0.2, ..Default::default() };
        assert_eq!(rates.position_rate(0.0, 2.0), 3.2e-4);
        assert!((rates.position_rate(1.0, 2.0) - 3.2e-6).abs() < 1e-18);
        assert!((rates.position_rate(0.5, 1.0) - 1.6e-5).abs() < 1e-15);
        assert!((rates.decay_at(0.6) - 0.1).abs() < 1e-12 && (rates.decay_at(1.0) - 0.01).abs() < 1e-12);
        assert!([0.0, 0.1, 0.2].iter().all(|&progress| rates.decay_at(progress) == 1.0));
        let train = TrainConfig { lambda_depth_maps: 0.5, depth_maps_decay: 0.04, ..Default::default() };
        assert_eq!(train.depth_map_weight(0.0), 0.5);
        assert!(
            (train.depth_map_weight(0.5) - 0.1).abs() < 1e-12 && (train.depth_map_weight(1.0) - 0.02).abs() < 1e-12
        );
        assert_eq!(rates.exposure_rate(0.0), rates.exposure);
        assert!((rates.exposure_rate(1.0) - 0.1 * rates.exposure).abs() < 1e-12);
    }

    #[test]
    fn poses_are_learnt_late_with_rates_that_rise_and_fall() {
        let rates = OptimizerConfig { pose_from: 0.2, pose_translation: 0.5, ..Default::default() };
        assert!(!rates.poses_are_learnt(0.199) && rates.poses_are_learnt(0.2));
        let factor = |completed: usize| {
            let step = rates.pose_step(completed, 1000, 2.0);
            assert!((step.translation / 0.5 - step.rotation / rates.pose_rotation).abs() < 1e-12);
            step.rotation / rates.pose_rotation
        };
        assert_eq!([0, 100, 200].map(factor), [0.0; 3]);
        // half of the way up, in the middle of what is left, at the end
        assert!((factor(250) - 0.25 * (1.0 + (PI / 16.0).cos())).abs() < 1e-12);
        assert!((factor(600) - 0.5).abs() < 1e-12 && factor(1000).abs() < 1e-12);
        let step = rates.pose_step(600, 1000, 2.0);
        assert_eq!((step.extent, step.adam.beta_1, step.adam.beta_2), (2.0, POSE_BETA, POSE_BETA));
    }

    #[test]
    fn zeros_and_auto_leave_the_choice_to_the_dataset() {
        let options = DataConfig { max_resolution: 0, ..Default::default() }.load_options();
        let memory = Memory::Auto.bytes();
        assert_eq!(options, LoadOptions { memory, ..LoadOptions::default() });
        let data =
            DataConfig { background: Background::Colour([1.0; 3]), image_scale: 4, near: 0.5, ..Default::default() };
        let options = data.load_options();
        assert_eq!((options.background, options.image_scale, options.near), (Some([1.0; 3]), Some(4), Some(0.5)));
        assert_eq!((options.max_resolution, options.depth), (Some(1600), None));
        let data = DataConfig { depth: DepthMaps::Relative, ..Default::default() };
        assert_eq!(data.load_options().depth, Some(DepthKind::Relative));
    }
}
