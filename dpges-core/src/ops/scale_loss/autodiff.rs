//! `scale_loss` on the tape.

use burn::backend::autodiff::checkpoint::base::Checkpointer;
use burn::backend::autodiff::checkpoint::strategy::CheckpointStrategy;
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::{Backward, Ops, OpsKind};
use burn::backend::tensor::FloatTensor;
use burn::backend::{Autodiff, AutodiffBackend};

use super::{ScaleLossBackwardOps, ScaleLossOps, ScaleLossOutput};
use crate::backend::tape::pass_back;

#[derive(Clone, Debug)]
struct ScaleLossState<F: Clone> {
    log_scales: F,
    log_mean: F,
    weight: f64,
}

#[derive(Debug)]
struct ScaleLossBackward;

impl<B: ScaleLossBackwardOps> Backward<B, 1> for ScaleLossBackward {
    type State = ScaleLossState<FloatTensor<B>>;

    fn backward(self, ops: Ops<Self::State, 1>, grads: &mut Gradients, _: &mut Checkpointer) {
        pass_back::<B, _, 1>(ops, grads, |ScaleLossState { log_scales, log_mean, weight }, grad| {
            [Some(B::scale_loss_backward(log_scales, log_mean, grad, weight))]
        });
    }
}

impl<B: ScaleLossOps + ScaleLossBackwardOps, S: CheckpointStrategy> ScaleLossOps for Autodiff<B, S> {
    fn scale_loss(log_scales: FloatTensor<Self>, weight: f64) -> ScaleLossOutput<Self> {
        let (log_scales, node) = log_scales.into_parts();
        let ScaleLossOutput { weighted, value, log_mean } = B::scale_loss(log_scales.clone(), weight);
        let kept = log_mean.clone();
        let weighted = match ScaleLossBackward.prepare::<S>([node]).compute_bound().stateful() {
            OpsKind::Tracked(prep) => prep.finish(ScaleLossState { log_scales, log_mean, weight }, weighted),
            OpsKind::UnTracked(prep) => prep.finish(weighted),
        };
        ScaleLossOutput {
            weighted,
            value: <Self as AutodiffBackend>::from_inner(value),
            log_mean: <Self as AutodiffBackend>::from_inner(kept),
        }
    }
}
