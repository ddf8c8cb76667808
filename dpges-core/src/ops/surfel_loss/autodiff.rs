//! `surfel_loss` on the tape.

use burn::backend::autodiff::checkpoint::base::Checkpointer;
use burn::backend::autodiff::checkpoint::strategy::CheckpointStrategy;
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::{Backward, Ops, OpsKind};
use burn::backend::{Autodiff, AutodiffBackend, Backend};

use super::{SurfelLossBackwardOps, SurfelLossInput, SurfelLossOps, SurfelLossOutput, SurfelLossWeights};
use crate::backend::tape::pass_back;

#[derive(Clone, Debug)]
struct SurfelLossState<B: Backend> {
    input: SurfelLossInput<B>,
    weights: SurfelLossWeights,
    masked: bool,
}

#[derive(Debug)]
struct SurfelLossBackward;

impl<B: SurfelLossBackwardOps> Backward<B, 2> for SurfelLossBackward {
    type State = SurfelLossState<B>;

    fn backward(self, ops: Ops<Self::State, 2>, grads: &mut Gradients, _: &mut Checkpointer) {
        pass_back::<B, _, 2>(ops, grads, |SurfelLossState { input, weights, masked }, grad| {
            let out = B::surfel_loss_backward(input, grad, weights, masked);
            [(weights.image != 0.0).then_some(out.image), (weights.transmittance != 0.0).then_some(out.transmittance)]
        });
    }
}

impl<B: SurfelLossOps + SurfelLossBackwardOps, S: CheckpointStrategy> SurfelLossOps for Autodiff<B, S> {
    fn surfel_loss(input: SurfelLossInput<Self>, weights: SurfelLossWeights, masked: bool) -> SurfelLossOutput<Self> {
        let (image, image_node) = input.image.into_parts();
        let (transmittance, transmittance_node) = input.transmittance.into_parts();
        let (target, ignored) = (input.target.into_parts().0, input.ignored.into_parts().0);
        let input = SurfelLossInput { image, transmittance, ids: input.ids, target, ignored };
        let out = B::surfel_loss(input.clone(), weights, masked);
        let nodes = [image_node, transmittance_node];
        let weighted = match SurfelLossBackward.prepare::<S>(nodes).compute_bound().stateful() {
            OpsKind::Tracked(prep) => prep.finish(SurfelLossState { input, weights, masked }, out.weighted),
            OpsKind::UnTracked(prep) => prep.finish(out.weighted),
        };
        SurfelLossOutput {
            weighted,
            image: <Self as AutodiffBackend>::from_inner(out.image),
            transmittance: <Self as AutodiffBackend>::from_inner(out.transmittance),
        }
    }
}
