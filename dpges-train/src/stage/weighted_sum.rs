//! Training of the numbers that all Gaussians of a weighted sum share: σ, β, and the weight of the background.

use std::collections::HashMap;

use burn::tensor::{Device, Gradients, Tensor};
use dpges_core::ops::adam::AdamStep;
use dpges_core::render::summed::WeightedSumTensors;
use dpges_core::scene::schema::{Activation, Attribute, RateGroup, Width};
use dpges_core::scene::tensors::tensor_to_rows;
use dpges_core::scene::{DepthWeight, WeightedSum};

use crate::optimizer::scene_state::GradientList;
use crate::optimizer::{Parameter, ParameterRows};

const fn number(name: &'static str) -> Attribute {
    Attribute {
        name,
        raw_name: name,
        width: Width::Fixed(1),
        activation: Activation::Identity,
        rate: RateGroup::WeightedSum,
        neutral: &[0.0],
    }
}

/// Each is [1, 1].
const ATTRIBUTES: [&Attribute; 3] =
    [&number("weighted_sum.sigma"), &number("weighted_sum.beta"), &number("weighted_sum.background")];

/// σ of linear weights at the start, extents: cameras see across the scene.
const SIGMA: f64 = 2.0;
/// w_b at the start (the re-implementation of SortFreeGS) and at least (ours), and its learning rate. Gaussians weigh 1 / 255
/// where they end: with a w_b far below that they are as bright at their edges as in their middle, and no gradient tells them
/// to grow over a hole beside them.
const BACKGROUND: f32 = 0.02;
const BACKGROUND_RATE: f64 = 0.01;
/// Learning rates of σ at the first and at the last step, extents. The logarithm is interpolated in between. A hundredth of
/// those of the public re-implementation of SortFreeGS, which leaves the factor of depth out by default: with those, σ can
/// fall below every depth, and then nothing is drawn and nothing has a gradient.
const SIGMA_RATES: [f64; 2] = [1e-3, 1e-5];
/// Learning rate of β relative to that of σ, both as shares of their starts.
const BETA_SHARE: f64 = 2.0;

/// Depth at which linear weights end at the start, and at which exponential ones are 1 / e, in a scene of `extent` (world
/// units).
fn reach(extent: f64) -> f64 {
    SIGMA * extent
}

/// The weighted sum that a run in a scene of `extent` (world units) begins with.
pub fn start(weight: DepthWeight, extent: f64) -> WeightedSum {
    let sigma = if weight == DepthWeight::Exponential { 1.0 / reach(extent) } else { reach(extent) };
    WeightedSum { weight, sigma: sigma as f32, beta: 1.0, background: BACKGROUND }
}

/// σ, β and w_b of a stage, with their moments.
#[derive(Clone, Debug)]
pub struct WeightedSumState {
    weight: DepthWeight,
    parameters: [Parameter; 3],
}

impl WeightedSumState {
    pub fn new(sum: &WeightedSum, device: &Device) -> Self {
        let values = [sum.sigma, sum.beta, sum.background];
        let fresh = |i: usize| Parameter::fresh(ATTRIBUTES[i], &values[i..=i], [1, 1], device);
        Self { weight: sum.weight, parameters: [0, 1, 2].map(fresh) }
    }

    /// Takes them out of `rows`.
    ///
    /// # Errors
    /// A message naming what is missing, or not one number with moments.
    pub fn from_rows(
        rows: &mut HashMap<String, ParameterRows>,
        weight: DepthWeight,
        device: &Device,
    ) -> Result<Self, String> {
        let mut take = |attribute: &'static Attribute| {
            let found = Parameter::take(attribute, rows, 1, |count| count == 1, 1, device)?;
            found.ok_or_else(|| format!("attribute `{}` is missing", attribute.raw_name))
        };
        let [sigma, beta, background] = ATTRIBUTES;
        Ok(Self { weight, parameters: [take(sigma)?, take(beta)?, take(background)?] })
    }

    pub fn rows(&self) -> impl Iterator<Item = (&'static str, ParameterRows)> {
        self.parameters.iter().map(Parameter::named_rows)
    }

    pub fn to_data(&self) -> WeightedSum {
        let [sigma, beta, background] = self.parameters.each_ref().map(|parameter| tensor_to_rows(&parameter.raw())[0]);
        WeightedSum { weight: self.weight, sigma, beta, background }
    }

    /// The numbers as leaves of a new tape, for one step.
    pub fn leaves(&self) -> WeightedSumTensors {
        let [sigma, beta, background] = self.parameters.each_ref().map(Parameter::leaf);
        WeightedSumTensors { sigma, beta, background }
    }

    /// The gradients that a backward pass left for the [`leaves`](Self::leaves).
    pub fn gradients(&self, leaves: &WeightedSumTensors, gradients: &mut Gradients) -> GradientList {
        let leaves = [&leaves.sigma, &leaves.beta, &leaves.background];
        self.parameters.iter().zip(leaves).map(|(parameter, leaf)| parameter.gradient(leaf, gradients)).collect()
    }

    /// Learning rates of σ, β and w_b at `progress` (0 at the first step, 1 at the last) in a scene of `extent` (world
    /// units). That of exponential weights moves the depth at which they are 1 / e at the start as fast as that of linear
    /// ones moves σ.
    pub fn rates(&self, progress: f64, extent: f64) -> [f64; 3] {
        let [first, last] = SIGMA_RATES;
        let (of_linear, reach) = (extent * first * (last / first).powf(progress.clamp(0.0, 1.0)), reach(extent));
        let of_sigma = if self.weight == DepthWeight::Exponential { of_linear / (reach * reach) } else { of_linear };
        [of_sigma, BETA_SHARE * of_linear / reach, BACKGROUND_RATE]
    }

    /// Nothing changes where `gate` `[1]` is not 1, but w_b is raised to its least value. `rates` are those of
    /// [`rates`](Self::rates).
    pub fn step(
        &mut self,
        gradients: GradientList,
        gate: &Tensor<1>,
        rates: [f64; 3],
        adam: AdamStep,
    ) -> dpges_core::Result<()> {
        for ((parameter, (_, gradient)), learning_rate) in self.parameters.iter_mut().zip(gradients).zip(rates) {
            parameter.step(gradient, gate, AdamStep { learning_rate, ..adam })?;
        }
        let [_, _, background] = &mut self.parameters;
        background.set_tensor(background.raw().clamp_min(BACKGROUND));
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use burn::tensor::DType;

    use super::*;
    use crate::run::fixtures::device;

    fn number(value: f32) -> Option<Tensor<2>> {
        Some(Tensor::full([1, 1], value, (&device(), DType::F32)))
    }

    fn stepped(state: &mut WeightedSumState, gradients: [Option<Tensor<2>>; 3], rates: [f64; 3], time: u64) {
        let open = Tensor::ones([1], (&device(), DType::F32));
        let adam = AdamStep { learning_rate: 0.0, beta_1: 0.9, beta_2: 0.999, epsilon: 1e-15, time };
        state.step(ATTRIBUTES.into_iter().zip(gradients).collect(), &open, rates, adam).unwrap();
    }

    #[test]
    fn exponential_weights_move_as_fast_as_linear_ones() {
        let device = device();
        let started = |weight, extent| WeightedSumState::new(&start(weight, extent), &device);
        assert_eq!(start(DepthWeight::Linear, 5.0), WeightedSum::default());
        assert_eq!(start(DepthWeight::Linear, 50.0).sigma, 100.0);
        let close = |found: [f64; 3], expected: [f64; 3]| {
            assert!(found.iter().zip(expected).all(|(a, b)| (a / b - 1.0).abs() < 1e-9), "{found:?}");
        };
        let linear = started(DepthWeight::Linear, 5.0);
        close(linear.rates(0.0, 5.0), [5e-3, 1e-3, 0.01]);
        close(linear.rates(0.5, 5.0), [5e-4, 1e-4, 0.01]);
        close(linear.rates(1.0, 5.0), [5e-5, 1e-5, 0.01]);
        assert_eq!(start(DepthWeight::Exponential, 5.0).sigma, 0.1);
        close(started(DepthWeight::Exponential, 5.0).rates(0.0, 5.0), [5e-5, 1e-3, 0.01]);
    }

    #[test]
    fn sigma_stays_beyond_the_scene_in_its_first_steps_and_the_background_keeps_its_weight() {
        let mut state = WeightedSumState::new(&start(DepthWeight::Linear, 5.0), &device());
        let rates = state.rates(0.0, 5.0);
        // every picture wants them smaller
        (1..=100).for_each(|time| stepped(&mut state, [number(1.0), None, number(1.0)], rates, time));
        let WeightedSum { sigma, background, .. } = state.to_data();
        assert!((9.0..9.6).contains(&sigma), "{sigma}");
        assert_eq!(background, BACKGROUND);
    }

    #[test]
    fn they_come_back_from_rows_with_their_moments() {
        let device = device();
        let sum = WeightedSum { weight: DepthWeight::Exponential, sigma: 0.3, beta: 1.25, background: 0.5 };
        let mut state = WeightedSumState::new(&sum, &device);
        assert_eq!(state.to_data(), sum);
        stepped(&mut state, [number(2.0), None, number(-1.0)], [0.1, 0.1, 0.01], 1);
        let WeightedSum { sigma, beta, background, .. } = state.to_data();
        assert!((sigma - 0.2).abs() < 1e-5 && beta == 1.25 && (background - 0.51).abs() < 1e-5);

        let rows = || state.rows().map(|(name, rows)| (name.to_owned(), rows)).collect::<HashMap<_, _>>();
        let read = WeightedSumState::from_rows(&mut rows(), DepthWeight::Exponential, &device).unwrap();
        assert_eq!(read.rows().collect::<Vec<_>>(), state.rows().collect::<Vec<_>>());
        let mut without = rows();
        without.remove("weighted_sum.beta");
        let error = WeightedSumState::from_rows(&mut without, DepthWeight::Linear, &device).unwrap_err();
        assert!(error.contains("`weighted_sum.beta` is missing"), "{error}");
    }
}
