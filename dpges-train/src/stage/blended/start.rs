//! The start of a stage of blended Gaussians: the points of the dataset.

use dpges_core::scene::schema::Columns;
use dpges_core::scene::{GaussianData, Rendering, SH_C0, SceneData, SurfelData};

use super::super::pretrained::SURFELS_FROM;
use super::super::{Context, TrainError};
use crate::config::{Blended, Relocation, StagePlan};
use crate::init::{InitialScene, PrimitiveQuota, PrimitiveStart, initialise};

/// Opacity of discs and of Gaussians under density control at the start (2DGS, 3DGS).
const OPACITY: f64 = 0.1;
/// Opacity of Gaussians that are relocated at the start (3DGS-MCMC).
const RELOCATED_OPACITY: f64 = 0.5;
/// Scale at the start relative to the root mean square distance to the 3 nearest points (2DGS, 3DGS).
const SCALE: f64 = 1.0;
/// The same for Student's t kernels (SSS).
const STUDENT_SCALE: f64 = 0.1;
/// Thickness of a Gaussian that is made of a surfel, over the mean of its two scales (GES).
const THICKNESS: f64 = 0.1;
/// Degrees of freedom of Student's t kernels at the start (SSS).
const START_DEGREES: f32 = 100.0;
/// Factor of opacities that depends on the direction at the start (weighted sums). The public re-implementation of
/// SortFreeGS begins with 0.1, where opacities are 2.5 / 255: many Gaussians then fall below 1 / 255 in their first steps,
/// and what is not drawn has no gradient that brings it back.
const START_FACTOR: f64 = 1.0;
/// Largest part of its budget with which a stage under density control begins: with all of it, nothing could be split.
const CONTROLLED_SHARE: f64 = 0.5;

impl Context {
    /// Discs of a file, or at the surfels that the configuration asks for, or at the Gaussians if there are no surfels.
    ///
    /// # Errors
    /// [`TrainError::Init`] if the dataset has nothing to begin with, [`TrainError::Pretrained`] if the file is of no use.
    pub fn start_of_discs(&mut self, plan: StagePlan) -> Result<GaussianData, TrainError> {
        match self.pretrained(SURFELS_FROM)? {
            Some(SceneData { info, gaussians, .. }) if info.rendering == Rendering::Discs => return Ok(gaussians),
            Some(SceneData { surfels, .. }) => return Ok(flat(surfels)),
            None => {}
        }
        let start = self.start(CONTROLLED_SHARE * plan.budget_share, OPACITY, SCALE)?;
        let mut discs = if start.surfels.is_empty() { start.gaussians } else { flat(start.surfels) };
        discs.opacities.fill(OPACITY as f32);
        Ok(discs)
    }

    pub fn start_of_gaussians(&mut self, plan: StagePlan, blended: Blended) -> Result<GaussianData, TrainError> {
        let is_student = blended.rendering() == Rendering::Students;
        let (opacity, scale) = match blended.relocation() {
            Some(Relocation::Student) => (RELOCATED_OPACITY, STUDENT_SCALE),
            Some(_) => (RELOCATED_OPACITY, self.config.relocation.start_scale),
            None => (OPACITY, SCALE),
        };
        let share = if matches!(blended, Blended::Controlled(_)) { CONTROLLED_SHARE } else { 1.0 };
        let mut start = match self.given_gaussians(self.most_primitives(plan.budget_share))? {
            Some(gaussians) => gaussians,
            None => self.start(share * plan.budget_share, opacity, scale)?.gaussians,
        };
        if is_student && start.degrees_of_freedom.is_none() {
            start.degrees_of_freedom = Some(vec![START_DEGREES; start.len()]);
        }
        let model = blended.colour_model(start.model());
        if model.opacity_len() > 0 {
            start.colour.model = model;
            start.opacity_base = vec![(START_FACTOR / SH_C0) as f32; start.len()];
            start.opacity_detail = vec![0.0; (model.opacity_len() - 1) * start.len()];
        }
        Ok(start)
    }

    fn start(
        &mut self,
        budget_share: f64,
        gaussian_opacity: f64,
        gaussian_scale: f64,
    ) -> Result<InitialScene, TrainError> {
        let quota = self.most_primitives(budget_share) as f64;
        let start = PrimitiveStart { surfel_scale: SCALE, gaussian_scale, gaussian_opacity };
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
