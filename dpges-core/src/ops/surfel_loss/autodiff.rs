//! `surfel_loss` on the tape.

use burn::backend::autodiff::checkpoint::strategy::CheckpointStrategy;
use burn::backend::{Autodiff, AutodiffBackend, Backend};

use super::{SurfelLossInput, SurfelLossOps, SurfelLossOutput, SurfelLossWeights};
use crate::backend::tape::{BackwardState, on_tape};

#[derive(Clone, Debug)]
pub struct SurfelLossState<B: Backend> {
    pub input: SurfelLossInput<B>,
    pub weights: SurfelLossWeights,
    pub masked: bool,
}

impl<B: SurfelLossOps, S: CheckpointStrategy> SurfelLossOps for Autodiff<B, S>
where
    SurfelLossState<B>: BackwardState<B, 2>,
{
    fn surfel_loss(input: SurfelLossInput<Self>, weights: SurfelLossWeights, masked: bool) -> SurfelLossOutput<Self> {
        let (image, image_node) = input.image.into_parts();
        let (transmittance, transmittance_node) = input.transmittance.into_parts();
        let (target, ignored) = (input.target.into_parts().0, input.ignored.into_parts().0);
        let input = SurfelLossInput { image, transmittance, ids: input.ids, target, ignored };
        let out = B::surfel_loss(input.clone(), weights, masked);
        let state = SurfelLossState { input, weights, masked };
        SurfelLossOutput {
            weighted: on_tape::<B, S, _, _>([image_node, transmittance_node], |_| (out.weighted, state)),
            image: <Self as AutodiffBackend>::from_inner(out.image),
            transmittance: <Self as AutodiffBackend>::from_inner(out.transmittance),
        }
    }
}
