//! The terms of the loss of surfels and Gaussians. A new one is a function, in the file of what it compares with, and an entry
//! of [`TERMS`].

use burn::tensor::Tensor;
use dpges_core::Result;
use dpges_core::losses::depth::surfel_depth;
use dpges_core::losses::{LossWeights, Losses, losses};

use super::measured::points;
use super::sky_masks::sky;
use super::supervision::geometry;
use super::{JointStage, RenderedView};

/// Each adds terms beside those of [`losses`], if the stage has them and the view shows something for them. Sums of floats
/// depend on their order.
const TERMS: [fn(&RenderedView<'_>, &mut Losses) -> Result<()>; 5] = [opacity_and_scale, points, sky, depth, geometry];

impl RenderedView<'_> {
    pub fn losses(&self) -> Result<Losses> {
        let train = &self.context.config.train;
        let weights = LossWeights {
            dssim: train.lambda_dssim,
            surfel: train.lambda_surfel,
            scale: train.lambda_scale,
            transmittance: train.lambda_transmittance,
        };
        // surfels of other blocks are constants: L_scale is that of this stage's own
        let mut losses =
            losses(self.rendered, self.own_surfels.log_scales.clone(), self.input.target.clone(), &weights)?;
        TERMS.iter().try_for_each(|add| add(self, &mut losses))?;
        Ok(losses)
    }

    /// The mean over the pixels that count, from `mean` over all pixels of what is 0 where they do not.
    pub fn of_counted(&self, mean: Tensor<1>) -> Tensor<1> {
        self.input.target.mask.as_ref().map_or(mean.clone(), |mask| mask.of_counted(mean))
    }
}

/// Those of 3DGS-MCMC; scales in extents, so that the unit of the dataset does not matter.
fn opacity_and_scale(view: &RenderedView<'_>, losses: &mut Losses) -> Result<()> {
    let (JointStage { sharding, held_down, info, .. }, own) = (view.stage, view.own_gaussians);
    if *held_down > 0.0 && !sharding.is_empty() {
        let train = &view.context.config.train;
        losses.add("opacity", sharding.mean(own.opacities.clone().abs()), held_down * train.lambda_opacity);
        let weight = held_down * train.lambda_gaussian_scale / info.extent;
        losses.add("gaussian_scale", sharding.mean(own.log_scales.clone().exp()), weight);
    }
    Ok(())
}

/// The difference to a depth map beside the photograph.
fn depth(view: &RenderedView<'_>, losses: &mut Losses) -> Result<()> {
    if let Some(target) = &view.input.depth {
        let [depth, coverage] = surfel_depth(view.rendered);
        losses.add("depth", target.loss(depth, coverage)?, target.weight);
    }
    Ok(())
}
