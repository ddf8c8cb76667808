//! Surfels and Gaussians as they are drawn: no finer than what the training views resolve, if the run limits that.

use dpges_core::scene::{GaussianData, Gaussians, SurfelData, Surfels};

use super::super::Context;
use super::super::sampling_limit::SamplingLimit;
use super::JointStage;
use crate::optimizer::scene_state::{GaussianState, SurfelState};

/// The filters of both kinds of primitives.
pub struct SamplingLimits {
    pub surfels: SamplingLimit,
    pub gaussians: SamplingLimit,
}

impl SamplingLimits {
    /// `None` if the run has no limit.
    pub fn new(surfels: &SurfelState, gaussians: &GaussianState, context: &Context) -> Option<Self> {
        let smoothing_px = context.config.model.sampling_limit;
        let limit = |positions| SamplingLimit::new(&positions, smoothing_px, context);
        (smoothing_px > 0.0).then(|| Self {
            surfels: limit(surfels.columns.positions.raw()),
            gaussians: limit(gaussians.columns.positions.raw()),
        })
    }
}

impl JointStage {
    /// `surfels` of this stage as they are drawn.
    pub fn drawn_surfels(&self, surfels: &Surfels) -> Surfels {
        self.limits.as_ref().map_or_else(|| surfels.clone(), |limits| limits.surfels.smoothed_surfels(surfels))
    }

    /// `gaussians` of this stage as they are drawn.
    pub fn drawn_gaussians(&self, gaussians: &Gaussians) -> Gaussians {
        self.limits.as_ref().map_or_else(|| gaussians.clone(), |limits| limits.gaussians.smoothed(gaussians))
    }

    /// All primitives as they are drawn, without a tape.
    pub fn drawn_values(&self) -> (Surfels, Gaussians) {
        (self.drawn_surfels(&self.surfels.values()), self.drawn_gaussians(&self.gaussians.values()))
    }

    /// The surfels as they are drawn, on the host.
    pub fn drawn_surfel_data(&self) -> SurfelData {
        let mut surfels = self.surfels.to_data();
        if let Some(limits) = &self.limits {
            limits.surfels.bake_surfels(&mut surfels);
        }
        surfels
    }

    /// The Gaussians as they are drawn, on the host.
    pub fn drawn_gaussian_data(&self) -> GaussianData {
        let mut gaussians = self.gaussians.to_data();
        if let Some(limits) = &self.limits {
            limits.gaussians.bake(&mut gaussians);
        }
        gaussians
    }
}
