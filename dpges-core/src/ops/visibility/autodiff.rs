//! `visibility` on the tape.

use burn::backend::autodiff::checkpoint::strategy::CheckpointStrategy;
use burn::backend::tensor::FloatTensor;
use burn::backend::{Autodiff, AutodiffBackend};

use super::{VisibilityInput, VisibilityOps, VisibilityOutput, VisibilityState};
use crate::backend::tape::{BackwardOfAll, all_on_tape};
use crate::scene::Peeling;

/// Gradients with respect to weights and to transmittance.
pub type Grads<B> = [Option<FloatTensor<B>>; 2];

impl<B: VisibilityOps, S: CheckpointStrategy> VisibilityOps for Autodiff<B, S>
where
    VisibilityState<B>: BackwardOfAll<B, 2, 2>,
{
    fn visibility(input: VisibilityInput<Self>, peeling: Peeling) -> VisibilityOutput<Self> {
        let (alpha, alpha_node) = input.alpha.into_parts();
        let (depth, depth_node) = input.depth.into_parts();
        let input = VisibilityInput { alpha, depth, ids: input.ids, margins: input.margins.into_parts().0 };
        let VisibilityOutput { weights, transmittance, limits } = B::visibility(input.clone(), peeling);
        let state = VisibilityState { input, peeling };
        let [weights, transmittance] =
            all_on_tape::<B, S, _, 2, 2>([alpha_node, depth_node], [weights, transmittance], state);
        VisibilityOutput { weights, transmittance, limits: <Self as AutodiffBackend>::from_inner(limits) }
    }
}
