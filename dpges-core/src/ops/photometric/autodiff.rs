//! `photometric` on the tape.

use burn::backend::autodiff::checkpoint::base::Checkpointer;
use burn::backend::autodiff::checkpoint::strategy::CheckpointStrategy;
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::{Backward, Ops, OpsKind};
use burn::backend::tensor::FloatTensor;
use burn::backend::{Autodiff, AutodiffBackend, Backend};

use super::{PhotometricBackwardOps, PhotometricInput, PhotometricOps, PhotometricOutput, PhotometricWeights};
use crate::backend::tape::pass_back;

#[derive(Clone, Debug)]
struct PhotometricState<B: Backend> {
    input: PhotometricInput<B>,
    partials: FloatTensor<B>,
    weights: PhotometricWeights,
    masked: bool,
}

#[derive(Debug)]
struct PhotometricBackward;

impl<B: PhotometricBackwardOps> Backward<B, 1> for PhotometricBackward {
    type State = PhotometricState<B>;

    fn backward(self, ops: Ops<Self::State, 1>, grads: &mut Gradients, _: &mut Checkpointer) {
        pass_back::<B, _, 1>(ops, grads, |PhotometricState { input, partials, weights, masked }, grad| {
            [Some(B::photometric_backward(input, partials, grad, weights, masked))]
        });
    }
}

impl<B: PhotometricOps + PhotometricBackwardOps, S: CheckpointStrategy> PhotometricOps for Autodiff<B, S> {
    fn photometric(
        input: PhotometricInput<Self>,
        weights: PhotometricWeights,
        masked: bool,
    ) -> PhotometricOutput<Self> {
        let (image, node) = input.image.into_parts();
        let (target, ignored) = (input.target.into_parts().0, input.ignored.into_parts().0);
        let input = PhotometricInput { image, target, ignored };
        let PhotometricOutput { value, squared_error, partials } = B::photometric(input.clone(), weights, masked);
        let kept = partials.clone();
        let value = match PhotometricBackward.prepare::<S>([node]).compute_bound().stateful() {
            OpsKind::Tracked(prep) => prep.finish(PhotometricState { input, partials, weights, masked }, value),
            OpsKind::UnTracked(prep) => prep.finish(value),
        };
        PhotometricOutput {
            value,
            squared_error: <Self as AutodiffBackend>::from_inner(squared_error),
            partials: <Self as AutodiffBackend>::from_inner(kept),
        }
    }
}
