//! `adam`: one step of the optimiser on any number of parameters, in place where nothing shares them.
//!
//! `m ← β1 m + (1 − β1) g`, `v ← β2 v + (1 − β2) g²`,
//! `θ ← θ − lr / (1 − β1^t) · m / (√v / √(1 − β2^t) + ε)` (Kingma and Ba). No gradient.
//! Nothing changes unless a gate on the device is 1: a bad gradient is held back without reading it back.
//!
//! The step is an operation because it works in place. Tensor operations take four times as long and hold
//! several copies of every attribute (`benches/README.md`). A launch on a GPU steps two parameters, whose six tensors and
//! the gate are as many buffers as every GPU can bind.

mod cpu;
#[cfg(feature = "gpu")]
mod cube;
#[cfg(test)]
mod tests;

use burn::backend::tensor::FloatTensor;
use burn::backend::{Backend, Dispatch, ExtensionType, backend_extension};
use burn::tensor::Tensor;

use crate::error::Result;
use crate::scene::tensors::check_shape;

/// What all parameters of a step have in common.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AdamStep {
    pub beta_1: f64,
    pub beta_2: f64,
    pub epsilon: f64,
    /// t ≥ 1: number of steps of these parameters, including this one.
    pub time: u64,
}

impl AdamStep {
    /// `learning_rate` over the bias correction of the first moment, and the reciprocal root of that of the second.
    fn corrected(&self, learning_rate: f64) -> [f64; 2] {
        let time = i32::try_from(self.time).unwrap_or(i32::MAX);
        [learning_rate / (1.0 - self.beta_1.powi(time)), 1.0 / (1.0 - self.beta_2.powi(time)).sqrt()]
    }
}

/// What a step changes of a parameter. Nothing of it is on a tape.
#[derive(Clone, Debug)]
pub struct AdamState {
    /// [rows, width]
    pub value: Tensor<2>,
    /// [2, rows, width] first and second moments.
    pub moments: Tensor<3>,
}

/// A parameter that is stepped.
#[derive(Clone, Debug)]
pub struct AdamParameter<'a> {
    /// As errors call it.
    pub name: &'a str,
    /// Changed in place if nothing else shares it.
    pub state: AdamState,
    /// [rows, width], off the tape.
    pub gradient: Tensor<2>,
    pub learning_rate: f64,
}

impl AdamParameter<'_> {
    fn check(&self) -> Result<()> {
        let [rows, width] = self.state.value.dims();
        check_shape(&format!("moments of {}", self.name), &self.state.moments, [2, rows, width])?;
        check_shape(&format!("gradient of {}", self.name), &self.gradient, [rows, width])
    }
}

/// The tensors of a parameter.
#[derive(ExtensionType, Debug, Clone)]
pub struct AdamTensors<B: Backend> {
    pub value: FloatTensor<B>,
    pub moments: FloatTensor<B>,
    pub gradient: FloatTensor<B>,
}

/// Parameters of one launch. Where there is one alone, the tensors of the second are its gradient.
#[derive(ExtensionType, Debug, Clone)]
pub struct AdamPair<B: Backend> {
    #[extension_type]
    pub first: AdamTensors<B>,
    #[extension_type]
    pub second: AdamTensors<B>,
}

#[backend_extension(Cube: cfg(feature = "gpu"), NdArray: cfg(feature = "ndarray"), Flex: cfg(feature = "flex"))]
pub trait AdamOps: Backend {
    /// The `pair` after a step with these learning rates. With one alone, the second that is returned means nothing.
    fn adam_step(
        #[extension_type] pair: AdamPair<Self>,
        gate: FloatTensor<Self>,
        learning_rates: (f64, Option<f64>),
        step: AdamStep,
    ) -> AdamPair<Self>;
}

/// Steps all `parameters`, of one element type, along their gradients if `gate` `[1]` is 1, and returns them in their order.
///
/// # Errors
/// [`crate::Error::Shape`] naming the moments or the gradient that differ in shape from their parameter, or the gate if it is
/// not one number.
pub fn adam_step(parameters: Vec<AdamParameter<'_>>, gate: &Tensor<1>, step: &AdamStep) -> Result<Vec<AdamState>> {
    check_shape("gate", gate, [1])?;
    parameters.iter().try_for_each(AdamParameter::check)?;
    let mut stepped = Vec::with_capacity(parameters.len());
    let mut parameters = parameters.into_iter();
    while let Some(first) = parameters.next() {
        let (first, rate) = tensors(first);
        let (second, second_rate) = match parameters.next().map(tensors) {
            Some((second, rate)) => (second, Some(rate)),
            None => {
                let absent = || first.gradient.clone();
                (AdamTensors { value: absent(), moments: absent(), gradient: absent() }, None)
            }
        };
        let pair = AdamPair { first, second };
        let AdamPair { first, second } =
            Dispatch::adam_step(pair, gate.clone().into_dispatch(), (rate, second_rate), *step);
        stepped.push(state(first));
        stepped.extend(second_rate.map(|_| state(second)));
    }
    Ok(stepped)
}

/// The tensors of a parameter and its learning rate.
fn tensors(parameter: AdamParameter<'_>) -> (AdamTensors<Dispatch>, f64) {
    let AdamParameter { state: AdamState { value, moments }, gradient, learning_rate, .. } = parameter;
    let (value, moments, gradient) = (value.into_dispatch(), moments.into_dispatch(), gradient.into_dispatch());
    (AdamTensors { value, moments, gradient }, learning_rate)
}

fn state(AdamTensors { value, moments, .. }: AdamTensors<Dispatch>) -> AdamState {
    AdamState { value: Tensor::from_dispatch(value), moments: Tensor::from_dispatch(moments) }
}
