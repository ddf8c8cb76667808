//! Positions by stochastic gradient Hamiltonian Monte Carlo (SSS).
//!
//! With the direction g of Adam, the rate η, the gate γ = 1 / (1 + exp(−100 ((1 − |o|) − 0.995))) and standard normal ξ,
//!
//! p ← γ p − η g − γ η C p + noise, μ ← μ + η p.
//!
//! In burn-in friction takes all of γ p, and the noise is V √(2 η C_b) γ ξ with the covariance V. After it, where momenta
//! begin at 0, the noise is √(2 η C) γ ξ. η² is the learning rate of positions that Adam would have.

use burn::tensor::{DType, Device, Tensor};
use dpges_core::ops::adam::AdamStep;
use dpges_core::ops::jitter::{JitterOptions, NoiseGate, jitter};
use dpges_core::scene::Gaussians;
use dpges_core::scene::tensors::{rows_to_tensor, tensor_to_rows};

use crate::optimizer::Parameter;
use crate::refine::mcmc_relocation::Relocated;

/// p: [M, 3] momenta of positions.
#[derive(Clone, Debug)]
pub struct Momenta(Tensor<2>);

#[derive(Clone, Copy, Debug)]
pub struct MomentumStep {
    /// World units of those that η, C and V are in.
    pub unit: f64,
    /// η
    pub rate: f64,
    pub burns_in: bool,
    /// C, or C_b in burn-in.
    pub friction: f64,
    /// Whether this is the first step after burn-in.
    pub restarts: bool,
    pub seed: u64,
}

impl Momenta {
    pub fn at_rest(count: usize, device: &Device) -> Self {
        Self::from_column(&vec![0.0; 3 * count], device)
    }

    /// From [M × 3] numbers.
    pub fn from_column(values: &[f32], device: &Device) -> Self {
        Self(rows_to_tensor(values, 3, device, DType::F32))
    }

    /// [M × 3] numbers.
    pub fn column(&self) -> Vec<f32> {
        tensor_to_rows(&self.0)
    }

    /// Changes the momenta and returns the positions [M, 3] after the step. `positions` has the Adam moments after `adam`,
    /// whose learning rate is not used; `gaussians` are the same, as they are drawn.
    pub fn step(
        &mut self,
        positions: &Parameter,
        gaussians: &Gaussians,
        adam: &AdamStep,
        step: &MomentumStep,
    ) -> dpges_core::Result<Tensor<2>> {
        let MomentumStep { unit, rate, burns_in, friction, restarts, seed } = *step;
        let magnitudes = gaussians.opacities.clone().abs();
        let mut momenta = direction(positions, adam) * -rate;
        if !burns_in && !restarts {
            // as the noise is gated; beyond e^80 it is 0, and more would overflow
            let gate = ((magnitudes.clone() - 0.005) * 100.0).clamp_max(80.0).exp().add_scalar(1.0).recip();
            momenta = momenta + self.0.clone() * (gate * (1.0 - rate * friction));
        }
        let log_scales =
            if burns_in { gaussians.log_scales.clone() - unit.ln() } else { gaussians.log_scales.zeros_like() };
        let amount = (2.0 * rate * friction).sqrt();
        let moved = Gaussians { positions: momenta, log_scales, opacities: magnitudes, ..gaussians.clone() };
        self.0 = jitter(&moved, &JitterOptions { gate: NoiseGate::Mcmc, amount, seed })?;
        Ok(positions.raw() + self.0.clone() * (rate * unit))
    }

    /// The momenta after relocation: sources keep theirs, what was relocated or added is at rest.
    pub fn relocate(&mut self, relocated: &Relocated) {
        let (device, count) = (self.0.device(), self.0.dims()[0]);
        let mut momenta = self.column();
        let moved = (0..count).filter(|&row| relocated.rows[row] != row);
        moved.for_each(|row| momenta[3 * row..3 * row + 3].fill(0.0));
        momenta.resize(3 * relocated.rows.len(), 0.0);
        *self = Self::from_column(&momenta, &device);
    }
}

/// The step that Adam would take with a learning rate of −1 (SSS): m̂ / (√v̂ + ε).
fn direction(positions: &Parameter, adam: &AdamStep) -> Tensor<2> {
    let [first, second] = positions.moments().expect("positions learn").clone();
    let unbiased = |beta: f64| 1.0 - beta.powi(i32::try_from(adam.time).unwrap_or(i32::MAX));
    let (first, second) = (first / unbiased(adam.beta_1), second / unbiased(adam.beta_2));
    first / (second.sqrt() + adam.epsilon)
}

#[cfg(test)]
mod tests {
    use dpges_core::scene::schema::{Columns, OpacityActivation};
    use dpges_core::scene::{ColourModel, GaussianData};

    use super::*;
    use crate::optimizer::ParameterRows;
    use crate::optimizer::scene_state::GaussianState;

    fn friction(burns_in: bool) -> f64 {
        if burns_in { 5e5 } else { 100.0 }
    }

    fn settings(rate: f64, burns_in: bool, restarts: bool, seed: u64) -> MomentumStep {
        MomentumStep { unit: 1.0, rate, burns_in, friction: friction(burns_in), restarts, seed }
    }

    const ADAM: AdamStep = AdamStep { learning_rate: 0.0, beta_1: 0.9, beta_2: 0.999, epsilon: 1e-15, time: 1 };

    /// Students of these opacities, with the moments of a first gradient (2, −3, 0.5) of each.
    fn state(opacities: &[f32], device: &Device) -> GaussianState {
        let count = opacities.len();
        let mut students = GaussianData::neutral(ColourModel::SphericalHarmonics { degree: 0 }, count);
        students.opacities = opacities.to_vec();
        students.log_scales = [-1.0, -2.0, -3.0].repeat(count);
        students.degrees_of_freedom = Some(vec![100.0; count]);
        let mut state = GaussianState::new(&students, OpacityActivation::Tanh, device);
        let gradient: Vec<f32> = [2.0f32, -3.0, 0.5].repeat(count);
        let moments = [gradient.iter().map(|g| 0.1 * g).collect(), gradient.iter().map(|g| 0.001 * g * g).collect()];
        let raw = vec![0.0; 3 * count];
        let rows = ParameterRows { count, width: 3, raw, moments: Some(moments) };
        state.columns.positions = Parameter::from_rows(&GaussianData::ATTRIBUTES[0], &rows, device);
        state
    }

    fn step(momenta: &mut Momenta, state: &GaussianState, step: &MomentumStep) -> Vec<f32> {
        tensor_to_rows(&momenta.step(&state.columns.positions, &state.values(), &ADAM, step).unwrap())
    }

    #[test]
    fn opaque_ones_move_by_the_square_of_the_rate() {
        let device = Device::flex();
        let state = state(&[0.9, -0.9], &device);
        for (burns_in, restarts) in [(true, false), (false, true), (false, false)] {
            let mut momenta = Momenta::from_column(&[7.0; 6], &device);
            let moved = step(&mut momenta, &state, &settings(0.02, burns_in, restarts, 1));
            // the first direction of Adam is the sign
            for (found, expected) in moved.iter().zip([-1.0f32, 1.0, -1.0].repeat(2)) {
                assert!((found - 4e-4 * expected).abs() < 1e-8, "{found} {expected}");
            }
        }
    }

    #[test]
    fn faint_ones_keep_momentum_after_burn_in_alone() {
        let device = Device::flex();
        let state = state(&[0.005, -0.005], &device);
        let found = |burns_in: bool, restarts: bool, before: f32| {
            let mut momenta = Momenta::from_column(&[before; 6], &device);
            step(&mut momenta, &state, &settings(1e-3, burns_in, restarts, 3));
            momenta.column()
        };
        // the noise is that of the seed, whatever came before
        let by_before = |burns_in: bool, restarts: bool| {
            let (moving, resting) = (found(burns_in, restarts, 2.0), found(burns_in, restarts, 0.0));
            moving.iter().zip(resting).map(|(a, b)| a - b).collect::<Vec<f32>>()
        };
        assert_eq!(by_before(true, false), [0.0; 6]);
        assert_eq!(by_before(false, true), [0.0; 6]);
        // γ (1 − η C) p with γ = ½
        for kept in by_before(false, false) {
            assert!((kept - 0.9).abs() < 1e-5, "{kept}");
        }
    }

    #[test]
    fn noise_has_the_variance_of_its_phase() {
        let device = Device::flex();
        let count = 4000;
        let state = state(&vec![0.005; count], &device);
        let rate = 1e-3;
        let deviations = |burns_in: bool| {
            let mut momenta = Momenta::at_rest(count, &device);
            step(&mut momenta, &state, &settings(rate, burns_in, true, 5));
            let rows = momenta.column();
            [0, 1, 2].map(|axis| {
                let values: Vec<f64> = rows.iter().skip(axis).step_by(3).map(|&p| f64::from(p)).collect();
                let mean = values.iter().sum::<f64>() / count as f64;
                (values.iter().map(|p| (p - mean).powi(2)).sum::<f64>() / count as f64).sqrt()
            })
        };
        // ½ √(2 η C), along the axes times the variances e^−2, e^−4, e^−6 in burn-in
        let after = 0.5 * (2.0 * rate * friction(false)).sqrt();
        for found in deviations(false) {
            assert!((found / after - 1.0).abs() < 0.05, "{found} {after}");
        }
        let during = 0.5 * (2.0 * rate * friction(true)).sqrt();
        for (found, log_variance) in deviations(true).into_iter().zip([-2.0f64, -4.0, -6.0]) {
            assert!((found / (during * log_variance.exp()) - 1.0).abs() < 0.05, "{found} {log_variance}");
        }
    }

    #[test]
    fn what_was_relocated_or_added_is_at_rest() {
        let device = Device::flex();
        let mut momenta = Momenta::from_column(&[1.0, 1.0, 1.0, 2.0, 2.0, 2.0, 3.0, 3.0, 3.0], &device);
        momenta.relocate(&Relocated {
            rows: vec![0, 0, 2, 2],
            opacities: vec![0.1; 4],
            log_scales: vec![0.0; 12],
            fresh_moments: vec![true, false, true, true],
            relocated: 1,
            added: 1,
        });
        assert_eq!(momenta.column(), [1.0, 1.0, 1.0, 0.0, 0.0, 0.0, 3.0, 3.0, 3.0, 0.0, 0.0, 0.0]);
    }
}
