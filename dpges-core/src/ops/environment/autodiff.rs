//! `environment` on the tape.

use burn::backend::autodiff::checkpoint::strategy::CheckpointStrategy;
use burn::backend::tensor::FloatTensor;
use burn::backend::{Autodiff, TensorMetadata};

use super::EnvironmentOps;
use crate::backend::tape::{BackwardState, on_tape};
use crate::camera::Camera;

#[derive(Clone, Debug)]
pub struct EnvironmentState {
    pub camera: Camera,
    /// Number of coefficients.
    pub count: usize,
}

impl<B: EnvironmentOps, S: CheckpointStrategy> EnvironmentOps for Autodiff<B, S>
where
    EnvironmentState: BackwardState<B, 1>,
{
    fn environment(coefficients: FloatTensor<Self>, camera: Camera) -> FloatTensor<Self> {
        let (coefficients, node) = coefficients.into_parts();
        let count = coefficients.shape()[0];
        on_tape::<B, S, _, _>([node], |_| (B::environment(coefficients, camera), EnvironmentState { camera, count }))
    }
}
