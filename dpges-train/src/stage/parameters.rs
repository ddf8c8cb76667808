//! The parameters of a stage, and what one step does with all of them.

use burn::tensor::{Gradients, Tensor};
use dpges_core::ops::adam::AdamStep;
use dpges_core::render::summed::WeightedSumTensors;
use dpges_core::scene::{Gaussians, Surfels};

use super::environment::EnvironmentState;
use super::weighted_sum::WeightedSumState;
use crate::optimizer::scene_state::{self, GaussianState, GradientList, Rates, SurfelState};
use crate::optimizer::{NamedGradient, Parameter};

pub struct Parameters<'a> {
    /// Empty in stages without surfels.
    pub surfels: &'a mut SurfelState,
    pub gaussians: &'a mut GaussianState,
    pub environment: &'a mut EnvironmentState,
    /// `None` in stages whose Gaussians are not summed.
    pub weighted_sum: Option<&'a mut WeightedSumState>,
}

/// Parameters on the tape of one step.
pub struct Leaves {
    pub surfels: Surfels,
    pub gaussians: Gaussians,
    /// [(degree + 1)², 3]; `None` in runs without one.
    pub environment: Option<Tensor<2>>,
    /// `None` in stages whose Gaussians are not summed.
    pub weighted_sum: Option<WeightedSumTensors>,
    raw_surfels: Surfels,
    raw_gaussians: Gaussians,
}

/// Gradients of surfels, Gaussians, the environment and the weighted sum; none for what a stage does not have.
pub struct ParameterGradients([GradientList; 4]);

/// Learning rates of a step; 0 by default.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct StepRates {
    pub surfels: Rates,
    pub gaussians: Rates,
    pub environment: f64,
    /// Learning rates of σ, β and w_b.
    pub weighted_sum: [f64; 3],
}

impl Parameters<'_> {
    pub fn leaves(&self) -> Leaves {
        let scene_state::Leaves { values: surfels, raw: raw_surfels } = self.surfels.leaves();
        let scene_state::Leaves { values: gaussians, raw: raw_gaussians } = self.gaussians.leaves();
        let weighted_sum = self.weighted_sum.as_ref().map(|sum| sum.leaves());
        let environment = self.environment.as_ref().map(Parameter::leaf);
        Leaves { surfels, gaussians, environment, weighted_sum, raw_surfels, raw_gaussians }
    }

    /// Takes out of `gradients` what a backward pass left for `leaves`.
    pub fn gradients(&self, leaves: &Leaves, gradients: &mut Gradients) -> ParameterGradients {
        let surfels = self.surfels.gradients(&leaves.raw_surfels, gradients);
        let gaussians = self.gaussians.gradients(&leaves.raw_gaussians, gradients);
        let environment = self.environment.iter().zip(&leaves.environment);
        let environment = environment.map(|(parameter, leaf)| parameter.gradient(leaf, gradients)).collect();
        let weighted_sum = match (&self.weighted_sum, &leaves.weighted_sum) {
            (Some(sum), Some(leaves)) => sum.gradients(leaves, gradients),
            _ => GradientList::new(),
        };
        ParameterGradients([surfels, gaussians, environment, weighted_sum])
    }

    /// Takes one optimisation step. Nothing changes where `gate` `[1]` is not 1.
    pub fn step(
        self,
        gradients: ParameterGradients,
        gate: &Tensor<1>,
        rates: &StepRates,
        adam: AdamStep,
    ) -> dpges_core::Result<()> {
        let ParameterGradients([surfels, gaussians, environment, weighted_sum]) = gradients;
        self.surfels.step(surfels, gate, &rates.surfels, adam)?;
        self.gaussians.step(gaussians, gate, &rates.gaussians, adam)?;
        for (parameter, (_, gradient)) in self.environment.iter_mut().zip(environment) {
            parameter.step(gradient, gate, AdamStep { learning_rate: rates.environment, ..adam })?;
        }
        match self.weighted_sum {
            Some(sum) => sum.step(weighted_sum, gate, rates.weighted_sum, adam),
            None => Ok(()),
        }
    }
}

impl ParameterGradients {
    /// The gradients after `change`.
    pub fn map(self, change: impl Fn(Tensor<2>) -> Tensor<2>) -> Self {
        let all = |list: GradientList| list.into_iter().map(|(of, gradient)| (of, gradient.map(&change))).collect();
        Self(self.0.map(all))
    }

    /// The gradients with their attributes; `None` where no gradient reached one.
    pub fn iter(&self) -> impl Iterator<Item = &NamedGradient> {
        self.0.iter().flatten()
    }
}
