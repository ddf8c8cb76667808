//! `composite` on the tape: each output has its own node over one forward pass.

use burn::backend::Autodiff;
use burn::backend::Backend;
use burn::backend::autodiff::checkpoint::base::Checkpointer;
use burn::backend::autodiff::checkpoint::strategy::CheckpointStrategy;
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::{Backward, Ops, OpsKind};
use burn::backend::tensor::FloatTensor;

use super::{CompositeBackwardOps, CompositeInput, CompositeOps, CompositeOptions, CompositeOutput, OutputKind};
use crate::tape::pass_back;

#[derive(Clone, Debug)]
struct CompositeState<B: Backend> {
    input: CompositeInput<B>,
    kind: OutputKind,
    options: CompositeOptions,
}

#[derive(Debug)]
struct CompositeBackward;

impl<B: CompositeBackwardOps> Backward<B, 3> for CompositeBackward {
    type State = CompositeState<B>;

    fn backward(self, ops: Ops<Self::State, 3>, grads: &mut Gradients, _: &mut Checkpointer) {
        pass_back::<B, _, 3>(ops, grads, |CompositeState { input, kind, options }, grad| {
            let out = B::composite_backward(input, grad, kind, options);
            let (colours, sums) = (kind.reaches_colours(), kind.reaches_sums());
            [Some(out.alpha), colours.then_some(out.colours), sums.then_some(out.sums)]
        });
    }
}

impl<B: CompositeOps + CompositeBackwardOps, S: CheckpointStrategy> CompositeOps for Autodiff<B, S> {
    fn composite(input: CompositeInput<Self>, options: CompositeOptions) -> CompositeOutput<Self> {
        let inner = |tensor: &FloatTensor<Self>| tensor.clone().into_parts().0;
        let values = CompositeInput {
            alpha: inner(&input.alpha),
            colours: inner(&input.colours),
            sums: inner(&input.sums),
            ids: input.ids.clone(),
        };
        let out = B::composite(values.clone(), options);
        let node = |value: FloatTensor<B>, kind: OutputKind| {
            let parents = [&input.alpha, &input.colours, &input.sums].map(|tensor| tensor.clone().into_parts().1);
            match CompositeBackward.prepare::<S>(parents).compute_bound().stateful() {
                OpsKind::Tracked(prep) => prep.finish(CompositeState { input: values.clone(), kind, options }, value),
                OpsKind::UnTracked(prep) => prep.finish(value),
            }
        };
        CompositeOutput {
            image: node(out.image, OutputKind::Image),
            surfel_image: node(out.surfel_image, OutputKind::SurfelImage),
            transmittance: node(out.transmittance, OutputKind::Transmittance),
            gaussian_colour: node(out.gaussian_colour, OutputKind::GaussianColour),
            gaussian_weight: node(out.gaussian_weight, OutputKind::GaussianWeight),
        }
    }
}
