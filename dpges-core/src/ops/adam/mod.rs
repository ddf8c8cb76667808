//! `adam`: one step of the optimiser on one parameter tensor, in place where nothing shares it.
//!
//! `m ← β1 m + (1 − β1) g`, `v ← β2 v + (1 − β2) g²`,
//! `θ ← θ − lr / (1 − β1^t) · m / (√v / √(1 − β2^t) + ε)` (Kingma and Ba). No gradient.
//! Nothing changes unless a gate on the device is 1: a bad gradient is held back without reading it back.
//!
//! The step is an operation because it works in place. Tensor operations take four times as long and hold
//! several copies of every attribute (`dpges-train/docs/log/2026-11-24-benchmarks.md`).

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

/// β1 and β2, and ε (3DGS).
pub const BETAS: [f64; 2] = [0.9, 0.999];
pub const EPSILON: f64 = 1e-15;

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AdamStep {
    pub learning_rate: f64,
    pub beta_1: f64,
    pub beta_2: f64,
    pub epsilon: f64,
    /// t ≥ 1: number of steps of this tensor, including this one.
    pub time: u64,
}

impl AdamStep {
    /// The learning rate over the bias correction of the first moment, and the reciprocal root of that of the second.
    fn corrected(&self) -> [f64; 2] {
        let time = i32::try_from(self.time).unwrap_or(i32::MAX);
        [self.learning_rate / (1.0 - self.beta_1.powi(time)), 1.0 / (1.0 - self.beta_2.powi(time)).sqrt()]
    }
}

#[derive(ExtensionType, Debug, Clone)]
pub struct AdamOutput<B: Backend> {
    pub parameter: FloatTensor<B>,
    pub moment_1: FloatTensor<B>,
    pub moment_2: FloatTensor<B>,
}

#[backend_extension(Cube: cfg(feature = "gpu"), NdArray: cfg(feature = "ndarray"), Flex: cfg(feature = "flex"))]
pub trait AdamOps: Backend {
    fn adam_step(
        parameter: FloatTensor<Self>,
        moment_1: FloatTensor<Self>,
        moment_2: FloatTensor<Self>,
        grad: FloatTensor<Self>,
        gate: FloatTensor<Self>,
        step: AdamStep,
    ) -> AdamOutput<Self>;
}

/// Steps `parameter` along `grad` if `gate` `[1]` is 1. Returns it with its first and second moments. All tensors
/// are off the tape. Those taken by value are changed in place if nothing else shares them.
///
/// # Errors
/// [`crate::Error::Shape`] if the four differ in shape or the gate is not one number.
pub fn adam_step<const D: usize>(
    parameter: Tensor<D>,
    [moment_1, moment_2]: [Tensor<D>; 2],
    grad: &Tensor<D>,
    gate: &Tensor<1>,
    step: &AdamStep,
) -> Result<(Tensor<D>, [Tensor<D>; 2])> {
    check_shape("moment 1", &moment_1, parameter.dims())?;
    check_shape("moment 2", &moment_2, parameter.dims())?;
    check_shape("gradient", grad, parameter.dims())?;
    check_shape("gate", gate, [1])?;
    let out = Dispatch::adam_step(
        parameter.into_dispatch(),
        moment_1.into_dispatch(),
        moment_2.into_dispatch(),
        grad.clone().into_dispatch(),
        gate.clone().into_dispatch(),
        *step,
    );
    Ok((
        Tensor::from_dispatch(out.parameter),
        [Tensor::from_dispatch(out.moment_1), Tensor::from_dispatch(out.moment_2)],
    ))
}
