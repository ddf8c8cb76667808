//! The terms of the loss of blended Gaussians beside L_rgb.

use burn::tensor::Tensor;
use dpges_core::losses::geometry::{expected_depth, normal_consistency, normals_from_depth};
use dpges_core::losses::{Losses, mean_of_counted};
use dpges_core::ops::blend::Maps;
use dpges_core::render::blended::BlendedRender;
use dpges_core::scene::Gaussians;

use super::super::StepInput;
use super::schedule::RELOCATION;
use crate::config::{DiscsConfig, Relocation, RelocationConfig, StagePlan};
use crate::optimizer::unit_of;

/// Steps from which normals and depth distortion of discs are in the loss (2DGS).
const NORMAL_FROM: usize = 7000;
const DISTORTION_FROM: usize = 3000;
/// Weight of the mean scale of relocated Gaussians, per world unit of a scene of the usual extent (3DGS-MCMC).
const LAMBDA_SCALE: f64 = 0.01;

#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Weights {
    /// Weight of the mean opacity, of its absolute value where opacities may be below 0.
    opacity: f64,
    signed: bool,
    /// Weight of the mean scale, per world unit.
    scale: f64,
    /// Weight of normals against those of the depth.
    normal: f64,
    /// Weight of the spread of depths along a ray.
    distortion: f64,
}

impl Weights {
    /// The weights of discs after `completed` steps (2DGS).
    pub fn of_discs(discs: &DiscsConfig, plan: StagePlan, completed: usize) -> Self {
        let from = |step: usize, weight: f64| if completed >= plan.scaled(step) { weight } else { 0.0 };
        Self {
            normal: from(NORMAL_FROM, discs.lambda_normal),
            distortion: from(DISTORTION_FROM, discs.lambda_distortion),
            ..Self::default()
        }
    }

    /// The weights of Gaussians after `completed` steps in a scene of `extent` (world units). DBS has these terms only as long as
    /// it relocates.
    pub fn of_relocated(
        config: &RelocationConfig,
        kind: Relocation,
        plan: StagePlan,
        completed: usize,
        extent: f64,
    ) -> Self {
        let relocates = (plan.scaled(RELOCATION.start)..plan.scaled(RELOCATION.end)).contains(&completed);
        if kind == Relocation::Beta && !relocates {
            return Self::default();
        }
        let signed = kind == Relocation::Student;
        Self { opacity: config.lambda_opacity, signed, scale: LAMBDA_SCALE / unit_of(extent), ..Self::default() }
    }

    /// Whether the terms need normals or distortions of every pixel.
    pub fn need_maps(&self) -> bool {
        self.normal > 0.0 || self.distortion > 0.0
    }

    /// Adds the terms to `losses`. Those of pixels are means over the pixels that count.
    pub fn add_to(&self, losses: &mut Losses, gaussians: &Gaussians, rendered: &BlendedRender, input: &StepInput<'_>) {
        if self.opacity > 0.0 {
            losses.add("opacity", self.mean_opacity(&gaussians.opacities), self.opacity);
        }
        if self.scale > 0.0 {
            losses.add("gaussian_scale", gaussians.log_scales.clone().exp().mean(), self.scale);
        }
        let Some(Maps { depth, normal, distortion, .. }) = rendered.blend.maps.clone() else { return };
        let mask = input.target.mask.as_ref();
        if self.normal > 0.0 {
            let alpha = rendered.blend.alpha.clone();
            let depth_normal = normals_from_depth(expected_depth(depth, alpha.clone()), &input.view.camera);
            losses.add("normal", normal_consistency(normal, depth_normal, alpha, mask), self.normal);
        }
        if self.distortion > 0.0 {
            losses.add("distortion", mean_of_counted(distortion, mask), self.distortion);
        }
    }

    fn mean_opacity(&self, opacities: &Tensor<2>) -> Tensor<1> {
        if self.signed { opacities.clone().abs().mean() } else { opacities.clone().mean() }
    }
}

#[cfg(test)]
mod tests {
    use dpges_core::testing::golden::values;

    use super::*;
    use crate::config::{Config, Method};
    use crate::run::fixtures::device;

    #[test]
    fn students_that_take_colour_away_fade_as_those_that_add_some() {
        let mean = |kind: Relocation, method: Method| {
            let mut config = Config::default();
            config.train.method = method;
            let weights = Weights::of_relocated(&config.relocation, kind, config.plan(0)[0], 0, 1.0);
            values(&weights.mean_opacity(&Tensor::from_floats([[-0.5], [0.25]], &device())))[0]
        };
        assert_eq!(mean(Relocation::Student, Method::Sss), 0.375);
        assert_eq!(mean(Relocation::Mcmc, Method::Mcmc), -0.125);
    }
}
