//! The start of a stage of blended Gaussians: the points of the dataset.

use dpges_core::scene::{GaussianData, SurfelData};

use super::super::{Context, TrainError};
use crate::config::{Blended, StagePlan};
use crate::init::{InitialScene, PrimitiveQuota, PrimitiveStart, initialise};

/// Opacity of discs and of Gaussians under density control at the start (2DGS, 3DGS).
const OPACITY: f64 = 0.1;
/// Opacity of Gaussians that are relocated at the start (3DGS-MCMC).
const RELOCATED_OPACITY: f64 = 0.5;
/// Scale at the start relative to the root mean square distance to the 3 nearest points (2DGS, 3DGS).
const SCALE: f64 = 1.0;
/// Thickness of a Gaussian that is made of a surfel, over the mean of its two scales (GES).
const THICKNESS: f64 = 0.1;

impl Context {
    /// Discs at the surfels that the configuration asks for, or at the Gaussians if there are no surfels.
    ///
    /// # Errors
    /// [`TrainError::Init`] if the dataset has nothing to begin with.
    pub fn start_of_discs(&mut self, plan: StagePlan) -> Result<GaussianData, TrainError> {
        let start = self.start(plan, OPACITY, SCALE)?;
        let mut discs = if start.surfels.is_empty() { start.gaussians } else { flat(start.surfels) };
        discs.opacities.fill(OPACITY as f32);
        Ok(discs)
    }

    /// # Errors
    /// [`TrainError::Init`] if the dataset has nothing to begin with.
    pub fn start_of_gaussians(&mut self, plan: StagePlan, blended: Blended) -> Result<GaussianData, TrainError> {
        let (opacity, scale) = match blended.relocation() {
            Some(_) => (RELOCATED_OPACITY, self.config.relocation.start_scale),
            None => (OPACITY, SCALE),
        };
        Ok(self.start(plan, opacity, scale)?.gaussians)
    }

    fn start(&mut self, plan: StagePlan, gaussian_opacity: f64, scale: f64) -> Result<InitialScene, TrainError> {
        let quota = self.most_primitives(plan.budget_share) as f64;
        let start = PrimitiveStart { surfel_scale: scale, gaussian_scale: scale, gaussian_opacity };
        Ok(initialise(&self.dataset, &self.config, start, PrimitiveQuota::new(quota, quota), &mut self.rng)?)
    }
}

/// Opaque flat Gaussians of the shape and colour of `surfels`.
fn flat(surfels: SurfelData) -> GaussianData {
    let thick = |&[x, y]: &[f32; 2]| {
        let mean = (f64::from(x).exp() + f64::from(y).exp()) / 2.0;
        [x, y, (THICKNESS * mean).ln() as f32]
    };
    let mut discs = GaussianData::neutral(surfels.colour.model, surfels.len());
    discs.log_scales = surfels.log_scales.as_chunks::<2>().0.iter().flat_map(thick).collect();
    discs.positions = surfels.positions;
    discs.quaternions = surfels.quaternions;
    discs.colour = surfels.colour;
    discs
}
