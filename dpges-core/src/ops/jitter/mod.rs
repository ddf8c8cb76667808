//! `jitter`: noise on the positions of faint Gaussians, along their own extent, so that they explore the scene
//! (3DGS-MCMC, DBS).
//!
//! μ ← μ + V (ξ · gate(o) · amount), where V = R diag(s²) Rᵀ is the covariance and ξ is standard normal. No gradient.
//! The noise of a row is a hash of the row and of a seed (Jarzynski and Olano, pcg4d; Box and Muller). It is the same on
//! every device up to rounding, and neither threads nor other rows matter.

mod cpu;
#[cfg(feature = "gpu")]
mod cube;
#[cfg(test)]
mod tests;

use burn::backend::tensor::FloatTensor;
use burn::backend::{Backend, Dispatch, ExtensionType, backend_extension};
use burn::tensor::Tensor;

use crate::error::Result;
use crate::scene::Gaussians;
use crate::scene::tensors::flat;

/// World units; Gaussians whose standard deviation of noise is below this stay where they are.
const MIN_DEVIATION: f64 = 1e-12;

/// How noise fades with opacity.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum NoiseGate {
    /// 1 / (1 + exp(−100 ((1 − o) − 0.995))) (3DGS-MCMC).
    Mcmc,
    /// (1 − o)^100 (DBS).
    Beta,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JitterOptions {
    pub gate: NoiseGate,
    /// 5e5 (3DGS-MCMC) or 5e4 (DBS) times the learning rate of positions in world units.
    pub amount: f64,
    /// Another seed is other noise.
    pub seed: u64,
}

impl JitterOptions {
    /// The halves of the seed.
    fn words(&self) -> [u32; 2] {
        [self.seed as u32, (self.seed >> 32) as u32]
    }
}

/// Tensors of [`jitter`].
#[derive(ExtensionType, Debug, Clone)]
pub struct JitterInput<B: Backend> {
    /// [M, 3]
    pub positions: FloatTensor<B>,
    /// [M, 4]
    pub quaternions: FloatTensor<B>,
    /// [M, 3]
    pub log_scales: FloatTensor<B>,
    /// `[M]`
    pub opacities: FloatTensor<B>,
}

#[backend_extension(Cube: cfg(feature = "gpu"), NdArray: cfg(feature = "ndarray"), Flex: cfg(feature = "flex"))]
pub trait JitterOps: Backend {
    fn jitter(#[extension_type] input: JitterInput<Self>, options: JitterOptions) -> FloatTensor<Self>;
}

/// Positions [M, 3] of `gaussians` with noise, world units. Opacities are from 0 to 1. Nothing is on a tape.
///
/// # Errors
/// [`crate::Error::Shape`] if the attributes do not fit each other.
pub fn jitter(gaussians: &Gaussians, options: &JitterOptions) -> Result<Tensor<2>> {
    gaussians.check_shapes()?;
    let input = JitterInput {
        positions: gaussians.positions.clone().into_dispatch(),
        quaternions: gaussians.quaternions.clone().into_dispatch(),
        log_scales: gaussians.log_scales.clone().into_dispatch(),
        opacities: flat(&gaussians.opacities).into_dispatch(),
    };
    Ok(Tensor::from_dispatch(Dispatch::jitter(input, *options)))
}
