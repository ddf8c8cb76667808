//! The parameters of a stage, and what one step does with all of them.

use burn::tensor::{Gradients, Tensor};
use dpges_core::ops::adam::AdamStep;
use dpges_core::render::summed::WeightedSumTensors;
use dpges_core::scene::schema::Attribute;
use dpges_core::scene::{Gaussians, Surfels};

use super::environment::{EnvironmentGradient, EnvironmentState};
use super::weighted_sum::WeightedSumState;
use crate::optimizer::scene_state::{self, GaussianState, GradientList, Rates, SurfelState};

/// The parameters that a stage trains.
pub struct Parameters<'a> {
    /// Empty in stages without surfels.
    pub surfels: &'a mut SurfelState,
    pub gaussians: &'a mut GaussianState,
    pub environment: &'a mut EnvironmentState,
    /// `None` in stages whose Gaussians are not summed.
    pub weighted_sum: Option<&'a mut WeightedSumState>,
}

/// The same, on the tape of one step.
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

/// Gradients of all parameters.
pub struct ParameterGradients {
    surfels: GradientList,
    gaussians: GradientList,
    environment: EnvironmentGradient,
    /// Empty in stages whose Gaussians are not summed.
    weighted_sum: GradientList,
}

/// Learning rates of one step.
#[derive(Clone, Copy, Debug, PartialEq)]
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
        Leaves { surfels, gaussians, environment: self.environment.leaf(), weighted_sum, raw_surfels, raw_gaussians }
    }

    /// Takes out of `gradients` what a backward pass left for `leaves`.
    pub fn gradients(&self, leaves: &Leaves, gradients: &mut Gradients) -> ParameterGradients {
        ParameterGradients {
            surfels: self.surfels.gradients(&leaves.raw_surfels, gradients),
            gaussians: self.gaussians.gradients(&leaves.raw_gaussians, gradients),
            environment: self.environment.gradient(leaves.environment.as_ref(), gradients),
            weighted_sum: match (&self.weighted_sum, &leaves.weighted_sum) {
                (Some(sum), Some(leaves)) => sum.gradients(leaves, gradients),
                _ => GradientList::new(),
            },
        }
    }

    /// Takes one optimisation step. Nothing changes where `gate` `[1]` is not 1.
    ///
    /// # Errors
    /// [`dpges_core::Error::Shape`] if the gradients belong to other rows.
    pub fn step(
        self,
        gradients: ParameterGradients,
        gate: &Tensor<1>,
        rates: &StepRates,
        adam: AdamStep,
    ) -> dpges_core::Result<()> {
        self.surfels.step(gradients.surfels, gate, &rates.surfels, adam)?;
        self.gaussians.step(gradients.gaussians, gate, &rates.gaussians, adam)?;
        let step = AdamStep { learning_rate: rates.environment, ..adam };
        self.environment.step(gradients.environment, gate, step)?;
        match self.weighted_sum {
            Some(sum) => sum.step(gradients.weighted_sum, gate, rates.weighted_sum, adam),
            None => Ok(()),
        }
    }
}

impl ParameterGradients {
    /// The same after `change`.
    pub fn map(self, change: impl Fn(Tensor<2>) -> Tensor<2>) -> Self {
        let all = |list: GradientList| list.into_iter().map(|(of, gradient)| (of, gradient.map(&change))).collect();
        Self {
            surfels: all(self.surfels),
            gaussians: all(self.gaussians),
            environment: self.environment.map(|(of, gradient)| (of, gradient.map(&change))),
            weighted_sum: all(self.weighted_sum),
        }
    }

    /// With their attributes; `None` where no gradient reached one.
    pub fn iter(&self) -> impl Iterator<Item = &(&'static Attribute, Option<Tensor<2>>)> {
        self.surfels.iter().chain(&self.gaussians).chain(&self.environment).chain(&self.weighted_sum)
    }
}
