//! The start of a stage of blended Gaussians: the points of the dataset.

use dpges_core::scene::{GaussianData, SurfelData};

use super::super::{Context, TrainError};
use crate::config::{Blended, StagePlan};
use crate::init::{PrimitiveQuota, initialise};

/// Thickness of a Gaussian that is made of a surfel, over the mean of its two scales (GES).
const THICKNESS: f64 = 0.1;

impl Context {
    /// Discs at the surfels that the configuration asks for, or at the Gaussians if there are no surfels.
    ///
    /// # Errors
    /// [`TrainError::Init`] if the dataset has nothing to begin with.
    pub fn start_of_discs(&mut self, plan: StagePlan) -> Result<GaussianData, TrainError> {
        let mut config = self.config.clone();
        config.init.surfel_scale = config.discs.start_scale;
        config.init.gaussian_scale = config.discs.start_scale;
        let opacity = config.discs.start_opacity as f32;
        let quota = self.most_primitives(plan.budget_share) as f64;
        let start = initialise(&self.dataset, &config, PrimitiveQuota::new(quota, quota), &mut self.rng)?;
        let mut discs = if start.surfels.is_empty() { start.gaussians } else { flat(start.surfels) };
        discs.opacities.fill(opacity);
        Ok(discs)
    }

    /// # Errors
    /// [`TrainError::Init`] if the dataset has nothing to begin with.
    pub fn start_of_gaussians(&mut self, plan: StagePlan, blended: Blended) -> Result<GaussianData, TrainError> {
        let mut config = self.config.clone();
        let (density, relocation) = (&config.density, &config.relocation);
        (config.init.gaussian_scale, config.init.gaussian_opacity) = match blended {
            Blended::Controlled(_) => (density.start_scale, density.start_opacity),
            Blended::Discs | Blended::Relocated(_) => (relocation.start_scale, relocation.start_opacity),
        };
        let quota = self.most_primitives(plan.budget_share) as f64;
        Ok(initialise(&self.dataset, &config, PrimitiveQuota::new(quota, quota), &mut self.rng)?.gaussians)
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
