//! `colour` on the tape.

use burn::backend::Autodiff;
use burn::backend::autodiff::checkpoint::base::Checkpointer;
use burn::backend::autodiff::checkpoint::strategy::CheckpointStrategy;
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::{Backward, Ops, OpsKind};
use burn::backend::tensor::FloatTensor;

use super::{ColourBackwardOps, ColourOps, DetailPart};
use crate::backend::tape::pass_back;

#[derive(Clone, Debug)]
struct ColourState<F: Clone> {
    detail: F,
    positions: F,
    centre: [f64; 3],
    part: DetailPart,
}

#[derive(Debug)]
struct ColourBackward;

impl<B: ColourBackwardOps> Backward<B, 2> for ColourBackward {
    type State = ColourState<FloatTensor<B>>;

    fn backward(self, ops: Ops<Self::State, 2>, grads: &mut Gradients, _: &mut Checkpointer) {
        pass_back::<B, _, 2>(ops, grads, |ColourState { detail, positions, centre, part }, grad| {
            let (base, detail) = B::colour_backward(detail, positions, grad, centre, part);
            [Some(base), Some(detail)]
        });
    }
}

impl<B: ColourOps + ColourBackwardOps, S: CheckpointStrategy> ColourOps for Autodiff<B, S> {
    fn colour(
        base: FloatTensor<Self>,
        detail: FloatTensor<Self>,
        positions: FloatTensor<Self>,
        centre: [f64; 3],
        part: DetailPart,
    ) -> FloatTensor<Self> {
        let (base, base_node) = base.into_parts();
        let (detail, detail_node) = detail.into_parts();
        let positions = positions.into_parts().0;
        let out = B::colour(base, detail.clone(), positions.clone(), centre, part);
        match ColourBackward.prepare::<S>([base_node, detail_node]).compute_bound().stateful() {
            OpsKind::Tracked(prep) => prep.finish(ColourState { detail, positions, centre, part }, out),
            OpsKind::UnTracked(prep) => prep.finish(out),
        }
    }
}
