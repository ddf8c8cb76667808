//! How learning rates and weights change over a run.

use std::f64::consts::PI;

use dpges_core::ops::adam::{AdamStep, BETAS, EPSILON};

use super::pose_step::PoseStep;
use crate::config::{OptimizerConfig, TrainConfig};

/// Factor on the learning rate of colour corrections at the last step.
const EXPOSURE_DECAY: f64 = 0.1;
/// Share of the last stage after which rates other than those of positions begin to decay.
const DECAY_FROM: f64 = 0.7;
/// Share of the run over which the learning rates of poses rise from 0.
const POSE_RISE: f64 = 0.1;
/// Decay of both of Adam's means for poses, each time that a view is seen, which is some dozens of times.
const POSE_BETA: f64 = 0.9;

impl TrainConfig {
    /// Weight of the loss of depth maps at `progress` of the whole run. Its logarithm is linear in `progress`.
    pub fn depth_map_weight(&self, progress: f64) -> f64 {
        self.lambda_depth_maps * between(1.0, self.depth_maps_decay, progress)
    }
}

impl OptimizerConfig {
    /// Adam's constants for the step after `completed` steps, without a learning rate. A step of a `batch` of views counts as so
    /// many, and forgets as much as they would (Grendel-GS).
    pub fn adam(&self, completed: usize, batch: usize) -> AdamStep {
        let [beta_1, beta_2] = BETAS.map(|beta| beta.powi(batch as i32));
        AdamStep { learning_rate: 0.0, beta_1, beta_2, epsilon: EPSILON, time: (completed / batch) as u64 + 1 }
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
            rate: self.poses * factor,
            extent,
            adam: AdamStep { beta_1: POSE_BETA, beta_2: POSE_BETA, ..self.adam(completed, 1) },
        }
    }

    /// Factor on every other learning rate at `progress` of the last stage.
    pub fn decay_at(&self, progress: f64) -> f64 {
        between(1.0, self.decay, (progress - DECAY_FROM) / (1.0 - DECAY_FROM))
    }
}

fn between(start: f64, end: f64, progress: f64) -> f64 {
    start * (end / start).powf(progress.clamp(0.0, 1.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_batch_forgets_as_much_as_its_views_one_by_one() {
        let config = OptimizerConfig::default();
        let (batch, last) = (config.adam(20, 4), config.adam(23, 1));
        assert_eq!((batch.time, last.time), (6, 24));
        assert!((batch.beta_1 - 0.9f64.powi(4)).abs() < 1e-15 && (batch.beta_2 - 0.999f64.powi(4)).abs() < 1e-15);
        // the same share of the gradients that are still to come
        assert!((batch.beta_2.powi(6) - last.beta_2.powi(24)).abs() < 1e-12);
    }

    #[test]
    fn rates_start_and_end_where_they_should() {
        let rates = OptimizerConfig { decay: 0.01, ..Default::default() };
        assert_eq!(rates.position_rate(0.0, 2.0), 3.2e-4);
        assert!((rates.position_rate(1.0, 2.0) - 3.2e-6).abs() < 1e-18);
        assert!((rates.position_rate(0.5, 1.0) - 1.6e-5).abs() < 1e-15);
        assert!((rates.decay_at(0.85) - 0.1).abs() < 1e-12 && (rates.decay_at(1.0) - 0.01).abs() < 1e-12);
        assert!([0.0, 0.1, 0.7].iter().all(|&progress| rates.decay_at(progress) == 1.0));
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
        let rates = OptimizerConfig { pose_from: 0.2, poses: 0.5, ..Default::default() };
        assert!(!rates.poses_are_learnt(0.199) && rates.poses_are_learnt(0.2));
        let factor = |completed: usize| rates.pose_step(completed, 1000, 2.0).rate / 0.5;
        assert_eq!([0, 100, 200].map(factor), [0.0; 3]);
        // half of the way up, in the middle of what is left, at the end
        assert!((factor(250) - 0.25 * (1.0 + (PI / 16.0).cos())).abs() < 1e-12);
        assert!((factor(600) - 0.5).abs() < 1e-12 && factor(1000).abs() < 1e-12);
        let step = rates.pose_step(600, 1000, 2.0);
        assert_eq!((step.extent, step.adam.beta_1, step.adam.beta_2), (2.0, POSE_BETA, POSE_BETA));
    }
}
