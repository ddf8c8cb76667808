//! `harmonics` on the tape.

use burn::backend::autodiff::checkpoint::base::Checkpointer;
use burn::backend::autodiff::checkpoint::strategy::CheckpointStrategy;
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::{Backward, Ops, OpsKind};
use burn::backend::tensor::FloatTensor;
use burn::backend::{Autodiff, TensorMetadata};

use super::{HarmonicsBackwardOps, HarmonicsOps};
use crate::backend::tape::pass_back;

#[derive(Clone, Debug)]
struct HarmonicsState<F: Clone> {
    positions: F,
    centre: [f64; 3],
    coefficients: usize,
}

#[derive(Debug)]
struct HarmonicsBackward;

impl<B: HarmonicsBackwardOps> Backward<B, 2> for HarmonicsBackward {
    type State = HarmonicsState<FloatTensor<B>>;

    fn backward(self, ops: Ops<Self::State, 2>, grads: &mut Gradients, _: &mut Checkpointer) {
        pass_back::<B, _, 2>(ops, grads, |HarmonicsState { positions, centre, coefficients }, grad| {
            let (base, detail) = B::harmonics_backward(positions, grad, centre, coefficients);
            [Some(base), Some(detail)]
        });
    }
}

impl<B: HarmonicsOps + HarmonicsBackwardOps, S: CheckpointStrategy> HarmonicsOps for Autodiff<B, S> {
    fn harmonics(
        base: FloatTensor<Self>,
        detail: FloatTensor<Self>,
        positions: FloatTensor<Self>,
        centre: [f64; 3],
    ) -> FloatTensor<Self> {
        let (base, base_node) = base.into_parts();
        let (detail, detail_node) = detail.into_parts();
        let positions = positions.into_parts().0;
        let coefficients = 1 + detail.shape()[1];
        let out = B::harmonics(base, detail, positions.clone(), centre);
        match HarmonicsBackward.prepare::<S>([base_node, detail_node]).compute_bound().stateful() {
            OpsKind::Tracked(prep) => prep.finish(HarmonicsState { positions, centre, coefficients }, out),
            OpsKind::UnTracked(prep) => prep.finish(out),
        }
    }
}
