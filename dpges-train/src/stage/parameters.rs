//! The parameters of a stage, and what one step does with all of them.

use burn::tensor::{Gradients, Tensor};
use dpges_core::scene::{Gaussians, Surfels};

use crate::config::Config;
use crate::scene_state::{GaussianState, GradientList, Rates, SurfelState};

/// What a stage trains.
pub struct Parameters<'a> {
    /// Empty in stages without surfels.
    pub surfels: &'a mut SurfelState,
    pub gaussians: &'a mut GaussianState,
}

/// The same, as leaves of the tape of one step.
pub struct Leaves {
    pub surfels: Surfels,
    pub gaussians: Gaussians,
    /// [M, 1] of which the opacities of `gaussians` are a function.
    opacities: Tensor<2>,
}

/// Gradients of all parameters.
pub struct ParameterGradients {
    surfels: GradientList,
    gaussians: GradientList,
}

impl Parameters<'_> {
    pub fn leaves(&self) -> Leaves {
        let (gaussians, opacities) = self.gaussians.leaves();
        Leaves { surfels: self.surfels.leaves(), gaussians, opacities }
    }

    /// Takes out of `gradients` what a backward pass left for `leaves`.
    pub fn gradients(&self, leaves: &Leaves, gradients: &mut Gradients) -> ParameterGradients {
        ParameterGradients {
            surfels: self.surfels.gradients(&leaves.surfels, gradients),
            gaussians: self.gaussians.gradients((&leaves.gaussians, &leaves.opacities), gradients),
        }
    }

    /// Takes the optimisation step after `completed` ones. Nothing changes where `gate` [1] is not 1.
    ///
    /// # Errors
    /// [`dpges_core::Error::Shape`] if the gradients belong to other rows.
    pub fn step(
        self,
        gradients: ParameterGradients,
        gate: &Tensor<1>,
        rates: Rates,
        completed: usize,
        config: &Config,
    ) -> dpges_core::Result<()> {
        let adam = config.optimizer.adam(completed);
        let surfel_rates = if config.train.freeze_surfels { rates.of_frozen_surfels() } else { rates };
        self.surfels.step(gradients.surfels, gate, &surfel_rates, adam)?;
        self.gaussians.step(gradients.gaussians, gate, &rates, adam)
    }
}

impl ParameterGradients {
    /// By the names of their attributes; `None` where no gradient reached one.
    pub fn named(&self) -> impl Iterator<Item = (&'static str, &Option<Tensor<2>>)> {
        let names = SurfelState::NAMES.into_iter().chain(GaussianState::NAMES);
        names.zip(self.surfels.iter().chain(&self.gaussians))
    }
}
