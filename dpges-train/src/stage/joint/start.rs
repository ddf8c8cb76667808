//! The start of the joint stage: trained discs and Gaussians, files, or the points of the dataset.

use dpges_core::scene::{GaussianData, Rendering, SceneData, ScreenFilter};

use super::super::pretrained::{GAUSSIANS_FROM, SURFELS_FROM};
use super::super::{Context, TrainError, Trained, environment};
use super::{JointStage, Supervisions};
use crate::config::{GaussianStage, HARD_RIM, JointOpacity, NewGaussians, OpacityActivation, StagePlan, SurfelStart};
use crate::init::promote::promote;
use crate::init::{InitialScene, PrimitiveQuota, PrimitiveStart, initialise};
use crate::refine::margins::margins;
use crate::refine::prune::small_surfels;

/// DP-GES starts from 50 to 60 % of the primitives it ends with.
const START_SHARE: f64 = 0.6;

impl JointStage {
    /// The stage of `plan`, with the discs and Gaussians that are `trained`.
    pub fn begin(plan: StagePlan, mut trained: Trained, context: &mut Context) -> Result<Self, TrainError> {
        let environment = environment::fresh(trained.environment.as_ref(), &context.device);
        if let Some(mut joined) = trained.joined.take() {
            let InitialScene { surfels, .. } = &mut joined;
            surfels.margins = margins(&surfels.positions, &surfels.log_scales, context.config.model.margin);
            return Ok(Self::new(plan, &joined, environment, None, context)?);
        }
        let given = context.pretrained(SURFELS_FROM)?;
        let from_file = given.as_ref().filter(|scene| scene.info.rendering == Rendering::Discs);
        let discs = trained.discs.as_ref().or(from_file.map(|scene| &scene.gaussians));
        let supervisions = match discs {
            Some(discs) if context.config.train.has_geometry_losses() => Some(Supervisions::new(discs, context)?),
            _ => None,
        };
        let model = &context.config.model;
        if model.layers == 1 && model.modulation < HARD_RIM {
            tracing::warn!(
                "with model.layers=1 the rims of surfels fade into nothing, so that surfels may grow over the picture and \
                 spoil it: set model.layers=2, or model.modulation={HARD_RIM}, whose rims are hard, with \
                 train.freeze_surfels=true, without which such surfels shrink away"
            );
        }
        let start = context.start_of_joint(given.as_ref(), discs, trained.gaussians)?;
        Ok(Self::new(plan, &start, environment, supervisions, context)?)
    }
}

impl Context {
    /// Surfels and Gaussians of the joint stage, with margins.
    fn start_of_joint(
        &mut self,
        given: Option<&SceneData>,
        discs: Option<&GaussianData>,
        gaussians: Option<GaussianData>,
    ) -> Result<InitialScene, TrainError> {
        let stages = self.config.stages.clone();
        let (mut surfels, rest) = match (discs, given) {
            (Some(discs), _) => {
                let (surfels, rest) = promote(discs, stages.surfel_opacity, stages.surfel_scale);
                let surfels = surfels.select(&small_surfels(&surfels.log_scales, self.dataset.extent));
                tracing::info!("{} of {} discs become surfels", surfels.len(), discs.len());
                if surfels.is_empty() {
                    tracing::warn!(
                        "no disc is more opaque than {} and small enough, so there are no surfels: train longer, give discs a larger share \
                         of the steps (stages.surfels), or lower stages.surfel_opacity",
                        stages.surfel_opacity
                    );
                }
                (Some(surfels), Some(rest))
            }
            (None, Some(scene)) => (Some(scene.surfels.clone()), None),
            (None, None) => (None, None),
        };
        // with the filter that they were blended with, if they were
        let (mut gaussians, blended_with) = match (gaussians, stages.gaussians_by) {
            (Some(gaussians), _) => (Some(gaussians), Some(ScreenFilter::Compensated)),
            (None, GaussianStage::Rest) => (rest, Some(ScreenFilter::Compensated)),
            (None, _) => match self.pretrained(GAUSSIANS_FROM)? {
                Some(SceneData { info, gaussians, .. }) => {
                    (Some(gaussians), (info.rendering != Rendering::Peeled).then_some(info.screen_filter))
                }
                None => (None, None),
            },
        };
        let by_depth = surfels.is_none() && stages.surfels_by == SurfelStart::Depth;
        if let (true, Some(trained), Some(filter)) = (by_depth, &gaussians, blended_with) {
            surfels = Some(self.surfels_of_depth(trained, filter)?);
        }
        if surfels.is_none() || gaussians.is_none() {
            let budget = self.budget_before_growth() as f64;
            let quota = PrimitiveQuota::new(budget * START_SHARE / 2.0, budget * START_SHARE);
            let start = initialise(&self.dataset, &self.config, PrimitiveStart::default(), quota, &mut self.rng)?;
            surfels.get_or_insert(start.surfels);
            gaussians.get_or_insert(start.gaussians);
        }
        let (mut surfels, mut gaussians) = (surfels.unwrap_or_default(), gaussians.unwrap_or_default());
        // a logistic opacity has no room above 1, and would hardly learn next to it
        let linear = self.config.model.opacity == OpacityActivation::Linear;
        if blended_with.is_some() && linear && stages.joint_opacity == JointOpacity::Odds {
            gaussians.opacities.iter_mut().for_each(|opacity| *opacity = odds(*opacity));
        }
        if surfels.is_empty() && gaussians.is_empty() {
            return Err(TrainError::Plan("the joint stage has neither surfels nor Gaussians to begin with".into()));
        }
        let (count, budget) = (surfels.len() + gaussians.len(), self.budget);
        if count > budget && self.config.refine.new_gaussians == NewGaussians::Black {
            tracing::warn!("the stage begins with {count} primitives, more than its budget of {budget}: none is added");
        }
        surfels.margins = margins(&surfels.positions, &surfels.log_scales, self.config.model.margin);
        Ok(InitialScene { surfels, gaussians })
    }
}

/// Largest opacity that is converted: more would not be seen, and take long to unlearn.
const MOST_OPAQUE: f32 = 0.9;

/// α / (1 − α): the weight against a surfel behind it, or the background, of weight 1 with which a Gaussian has the share α
/// of a pixel, as when it was blended.
fn odds(opacity: f32) -> f32 {
    let opacity = opacity.clamp(0.0, MOST_OPAQUE);
    opacity / (1.0 - opacity)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn odds_give_a_gaussian_before_a_surfel_its_share() {
        for share in [0.0, 0.1, 0.5, 0.8] {
            let weight = odds(share);
            assert!((weight / (1.0 + weight) - share).abs() < 1e-6);
        }
        assert_eq!(odds(1.0), odds(MOST_OPAQUE));
    }
}
