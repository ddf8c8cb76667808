//! `composite` on the tape. The outputs of a call have nodes that keep the gradients that arrive for them; these have one
//! parent, which goes back from all of them at once.

use std::sync::{Arc, Mutex, PoisonError};

use burn::backend::autodiff::checkpoint::base::Checkpointer;
use burn::backend::autodiff::checkpoint::strategy::CheckpointStrategy;
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::{Backward, Ops, OpsKind};
use burn::backend::tensor::FloatTensor;
use burn::backend::{Autodiff, Backend, TensorMetadata};

use super::{
    CompositeBackwardOps, CompositeInput, CompositeOps, CompositeOptions, CompositeOutput, CompositeState,
    OutputGradients, OutputKind,
};
use crate::backend::tape::{WayBack, on_tape};

/// The gradients that have arrived for the outputs of a call.
type Arrived<B> = Arc<Mutex<OutputGradients<B>>>;

/// Keeps the gradient of an output for the node of the call.
#[derive(Clone, Debug)]
struct OutputState<B: Backend> {
    kind: OutputKind,
    arrived: Arrived<B>,
}

impl<B: Backend> WayBack<B, 1> for OutputState<B> {
    fn go_back(self, grad: FloatTensor<B>) -> [Option<FloatTensor<B>>; 1] {
        self.arrived.lock().unwrap_or_else(PoisonError::into_inner)[self.kind as usize] = Some(grad);
        [None]
    }
}

/// Goes back from all outputs of a call.
#[derive(Debug)]
struct CompositeBackward;

impl<B: CompositeBackwardOps> Backward<B, 3> for CompositeBackward {
    type State = (CompositeState<B>, Arrived<B>);

    fn backward(self, ops: Ops<Self::State, 3>, grads: &mut Gradients, _: &mut Checkpointer) {
        let (state, arrived) = ops.state;
        let of_outputs = std::mem::take(&mut *arrived.lock().unwrap_or_else(PoisonError::into_inner));
        let CompositeInput { alpha, colours, sums, .. } = state.input.clone();
        let found = B::composite_backward(state, of_outputs);
        for ((parent, grad), like) in ops.parents.into_iter().zip(found).zip([alpha, colours, sums]) {
            if let Some(parent) = parent {
                // the tape expects a gradient for all that is on it
                let zeros = || B::float_zeros(like.shape(), &like.device(), like.dtype().into());
                grads.register::<B>(parent.id, grad.unwrap_or_else(zeros));
            }
        }
    }
}

impl<B: CompositeOps + CompositeBackwardOps, S: CheckpointStrategy> CompositeOps for Autodiff<B, S> {
    fn composite(input: CompositeInput<Self>, options: CompositeOptions) -> CompositeOutput<Self> {
        let (alpha, alpha_node) = input.alpha.into_parts();
        let (colours, colours_node) = input.colours.into_parts();
        let (sums, sums_node) = input.sums.into_parts();
        let input = CompositeInput { alpha, colours, sums, ids: input.ids };
        let out = B::composite(input.clone(), options);
        let arrived: Arrived<B> = Arc::default();
        let nodes = [alpha_node, colours_node, sums_node];
        // its value is of no use, its place on the tape is
        let call = match CompositeBackward.prepare::<S>(nodes).compute_bound().stateful() {
            OpsKind::Tracked(prep) => {
                let (image, gaussian_weight) = (out.image.clone(), out.gaussian_weight.clone());
                let state = CompositeState { input, image, gaussian_weight, options };
                prep.finish((state, arrived.clone()), out.gaussian_weight.clone())
            }
            OpsKind::UnTracked(prep) => prep.finish(out.gaussian_weight.clone()),
        };
        let output = |value: FloatTensor<B>, kind: OutputKind| {
            let node = call.clone().into_parts().1;
            on_tape::<B, S, _, _>([node], |_| (value, OutputState { kind, arrived: arrived.clone() }))
        };
        CompositeOutput {
            image: output(out.image, OutputKind::Image),
            surfel_image: output(out.surfel_image, OutputKind::SurfelImage),
            transmittance: output(out.transmittance, OutputKind::Transmittance),
            gaussian_colour: output(out.gaussian_colour, OutputKind::GaussianColour),
            gaussian_weight: output(out.gaussian_weight, OutputKind::GaussianWeight),
        }
    }
}
