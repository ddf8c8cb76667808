//! `composite` on the tape.

use burn::backend::Autodiff;
use burn::backend::autodiff::checkpoint::strategy::CheckpointStrategy;

use super::{CompositeInput, CompositeOps, CompositeOptions, CompositeOutput, CompositeState};
use crate::backend::tape::{BackwardOfAll, all_on_tape};

impl<B: CompositeOps, S: CheckpointStrategy> CompositeOps for Autodiff<B, S>
where
    CompositeState<B>: BackwardOfAll<B, 4, 4>,
{
    fn composite(input: CompositeInput<Self>, options: CompositeOptions) -> CompositeOutput<Self> {
        let (weights, weights_node) = input.weights.into_parts();
        let (transmittance, transmittance_node) = input.transmittance.into_parts();
        let (colours, colours_node) = input.colours.into_parts();
        let (sums, sums_node) = input.sums.into_parts();
        let input = CompositeInput { weights, transmittance, colours, sums, ids: input.ids };
        let out = B::composite(input.clone(), options);
        let (image, gaussian_weight) = (out.image.clone(), out.gaussian_weight.clone());
        let state = CompositeState { input, image, gaussian_weight, options };
        let nodes = [weights_node, transmittance_node, colours_node, sums_node];
        let outputs = [out.image, out.surfel_image, out.gaussian_colour, out.gaussian_weight];
        let [image, surfel_image, gaussian_colour, gaussian_weight] =
            all_on_tape::<B, S, _, 4, 4>(nodes, outputs, state);
        CompositeOutput { image, surfel_image, gaussian_colour, gaussian_weight }
    }
}
