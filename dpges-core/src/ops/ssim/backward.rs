//! `ssim` on the tape.

use burn::backend::autodiff::checkpoint::base::Checkpointer;
use burn::backend::autodiff::checkpoint::strategy::CheckpointStrategy;
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::{Backward, Ops, OpsKind};
use burn::backend::tensor::FloatTensor;
use burn::backend::{Autodiff, AutodiffBackend};

use super::{SsimBackwardOps, SsimOps, SsimOutput};
use crate::tape::pass_back;

#[derive(Clone, Debug)]
struct SsimState<F: Clone> {
    image: F,
    target: F,
    partials: F,
}

#[derive(Debug)]
struct SsimBackward;

impl<B: SsimBackwardOps> Backward<B, 1> for SsimBackward {
    type State = SsimState<FloatTensor<B>>;

    fn backward(self, ops: Ops<Self::State, 1>, grads: &mut Gradients, _: &mut Checkpointer) {
        pass_back::<B, _, 1>(ops, grads, |SsimState { image, target, partials }, grad| {
            [Some(B::ssim_backward(image, target, partials, grad))]
        });
    }
}

impl<B: SsimOps + SsimBackwardOps, S: CheckpointStrategy> SsimOps for Autodiff<B, S> {
    fn ssim(image: FloatTensor<Self>, target: FloatTensor<Self>) -> SsimOutput<Self> {
        let (image, node) = image.into_parts();
        let target = target.into_parts().0;
        let SsimOutput { value, partials } = B::ssim(image.clone(), target.clone());
        let kept = partials.clone();
        let value = match SsimBackward.prepare::<S>([node]).compute_bound().stateful() {
            OpsKind::Tracked(prep) => prep.finish(SsimState { image, target, partials }, value),
            OpsKind::UnTracked(prep) => prep.finish(value),
        };
        SsimOutput { value, partials: <Self as AutodiffBackend>::from_inner(kept) }
    }
}
