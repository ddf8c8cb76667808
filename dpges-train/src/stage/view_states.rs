//! States of the training views that a run learns beside the scene: exposures, poses; and their depth maps.

use std::sync::Arc;

use burn::tensor::{DType, Device};
use dpges_core::ops::adam::AdamStep;
use dpges_core::render::pose::PoseProbe;

use super::{Context, TrainError};
use crate::config::Exposure;
use crate::dataset::Dataset;
use crate::views::depth::{DepthMaps, DepthTarget};
use crate::views::exposure::brightness_spread;
use crate::views::exposure::state::{ExposureState, LARGE_SPREAD, fresh};
use crate::views::pose::{LARGE_PX, PoseChanges, PoseState, RefinedPose, RefinedPoses, are_learnt};

impl Context {
    /// The corrections that a run begins with.
    ///
    /// # Errors
    /// [`TrainError::Core`] if a photograph cannot be read again.
    pub fn start_of_exposure(&self) -> Result<ExposureState, TrainError> {
        let spread = brightness_spread(&self.dataset)?;
        let said = match spread {
            Some(stops) => format!(
                "the brightness of the same points differs by {stops:.2} stops between photographs, by standard deviation"
            ),
            None => "which photographs are brighter is not known without points that they show".to_owned(),
        };
        let is_large = spread.is_some_and(|stops| stops > LARGE_SPREAD);
        let is_on = match self.config.train.exposure {
            Exposure::On => true,
            Exposure::Off => false,
            Exposure::Auto => is_large,
        };
        match (is_on, is_large) {
            (true, _) => tracing::info!("{said}: exposures are corrected (train.exposure)"),
            (false, true) => tracing::info!("{said}: train.exposure = \"on\" corrects exposures"),
            (false, false) => tracing::debug!("{said}: photographs are taken as they are (train.exposure)"),
        }
        Ok(if is_on { fresh(self.dataset.train.len(), &self.device) } else { None })
    }

    /// The step of the corrections in the current step of the run, on a `batch` of views.
    pub fn exposure_step(&self, batch: usize) -> AdamStep {
        let learning_rate = self.config.optimizer.exposure_rate(self.progress()) * (batch as f64).sqrt();
        AdamStep { learning_rate, ..self.config.optimizer.adam(self.completed_steps, batch) }
    }
}

impl Context {
    /// The corrections that a run begins with.
    pub fn start_of_poses(&self) -> PoseState {
        let is_on = are_learnt(self.config.train.poses, &self.dataset);
        if let (Some(px), false) = (self.dataset.reprojection_px.filter(|&px| px > LARGE_PX), is_on) {
            tracing::info!(
                "points are {px:.1} px from where photographs show them: train.poses = \"on\" corrects cameras"
            );
        }
        if is_on { PoseState::new(&self.dataset) } else { PoseState::default() }
    }

    /// Receives the gradient of the pose of the training view with index `view`; `None` if poses are not learnt, or not
    /// yet.
    pub fn pose_probe(&self, view: usize) -> Option<PoseProbe> {
        let learnt = self.poses.is_on() && self.config.optimizer.poses_are_learnt(self.progress());
        learnt.then(|| PoseProbe::new(&self.dataset.train[view].camera, &self.tape(), DType::F32))
    }

    /// Moves cameras as the gradients say that are due. Before every step.
    pub fn refine_poses(&mut self) {
        let (optimizer, steps, extent) = (&self.config.optimizer, self.config.total_steps(), self.dataset.extent);
        if self.poses.advance(self.completed_steps, |completed| optimizer.pose_step(completed, steps, extent)) {
            self.place_cameras();
        }
    }

    /// Puts the cameras of the training views where they are by their corrections, if there are any.
    pub fn place_cameras(&mut self) {
        if !self.poses.is_on() {
            return;
        }
        let views = Arc::make_mut(&mut self.dataset).train.iter_mut();
        for ((view, recorded), correction) in views.zip(self.poses.recorded()).zip(self.poses.corrections()) {
            view.camera.camera_from_world = correction.applied(recorded);
        }
    }

    /// The dataset with its cameras as they were recorded: for what has to be the same whenever it is looked at.
    pub fn recorded(&self) -> Arc<Dataset> {
        let mut dataset = self.dataset.clone();
        if self.poses.is_on() {
            let views = Arc::make_mut(&mut dataset).train.iter_mut();
            views.zip(self.poses.recorded()).for_each(|(view, recorded)| view.camera.camera_from_world = *recorded);
        }
        dataset
    }

    /// The poses of the training views by name; `None` if they are as they were recorded.
    pub fn refined_poses(&self) -> Option<RefinedPoses> {
        if !self.poses.is_on() {
            return None;
        }
        let poses = self.poses.corrections().into_iter().zip(self.poses.recorded());
        let poses = poses.map(|(correction, recorded)| RefinedPose::new(correction, recorded, self.dataset.offset));
        Some(self.dataset.train.iter().map(|view| view.name.clone()).zip(poses).collect())
    }

    /// How far cameras have been moved; `None` if they are where they were recorded.
    pub fn pose_changes(&self) -> Option<PoseChanges> {
        self.poses.is_on().then(|| PoseChanges::of(&self.poses.corrections(), self.dataset.extent))
    }
}

impl Context {
    /// The depth maps that a run learns from; `None` without any.
    pub fn start_of_depth(&self) -> Option<DepthMaps> {
        if self.config.train.lambda_depth_maps > 0.0 { DepthMaps::new(&self.dataset) } else { None }
    }

    /// The target from the map of the training view with index `view` in the current step, on `device`.
    pub fn depth_target(&self, view: usize, device: &Device) -> Option<DepthTarget> {
        let map = self.dataset.train[view].depth.as_ref()?;
        let weight = self.config.train.depth_map_weight(self.progress());
        Some(self.depth.as_ref()?.target(map, view, &self.dataset.train[view].camera, weight, device))
    }
}
