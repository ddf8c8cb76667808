//! `environment` on the tape.

use burn::backend::Autodiff;
use burn::backend::TensorMetadata;
use burn::backend::autodiff::checkpoint::base::Checkpointer;
use burn::backend::autodiff::checkpoint::strategy::CheckpointStrategy;
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::{Backward, Ops, OpsKind};
use burn::backend::tensor::FloatTensor;

use super::{EnvironmentBackwardOps, EnvironmentOps, PixelRays};
use crate::backend::tape::pass_back;

#[derive(Clone, Debug)]
struct EnvironmentState {
    rays: PixelRays,
    count: usize,
}

#[derive(Debug)]
struct EnvironmentBackward;

impl<B: EnvironmentBackwardOps> Backward<B, 1> for EnvironmentBackward {
    type State = EnvironmentState;

    fn backward(self, ops: Ops<Self::State, 1>, grads: &mut Gradients, _: &mut Checkpointer) {
        pass_back::<B, _, 1>(ops, grads, |EnvironmentState { rays, count }, grad| {
            [Some(B::environment_backward(grad, rays, count))]
        });
    }
}

impl<B: EnvironmentOps + EnvironmentBackwardOps, S: CheckpointStrategy> EnvironmentOps for Autodiff<B, S> {
    fn environment(coefficients: FloatTensor<Self>, rays: PixelRays) -> FloatTensor<Self> {
        let (coefficients, node) = coefficients.into_parts();
        let count = coefficients.shape()[0];
        let out = B::environment(coefficients, rays);
        match EnvironmentBackward.prepare::<S>([node]).compute_bound().stateful() {
            OpsKind::Tracked(prep) => prep.finish(EnvironmentState { rays, count }, out),
            OpsKind::UnTracked(prep) => prep.finish(out),
        }
    }
}
