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
    CompositeBackwardOps, CompositeInput, CompositeOps, CompositeOptions, CompositeOutput, OutputGradients, OutputKind,
};

/// The gradients that have arrived for the outputs of a call.
type Arrived<B> = Arc<Mutex<OutputGradients<B>>>;

#[derive(Clone, Debug)]
struct OutputState<B: Backend> {
    kind: OutputKind,
    arrived: Arrived<B>,
}

/// Keeps the gradient of an output for the node of the call.
#[derive(Debug)]
struct OutputBackward;

impl<B: Backend> Backward<B, 1> for OutputBackward {
    type State = OutputState<B>;

    fn backward(self, ops: Ops<Self::State, 1>, grads: &mut Gradients, _: &mut Checkpointer) {
        let OutputState { kind, arrived } = ops.state;
        let grad = grads.consume::<B>(&ops.node);
        arrived.lock().unwrap_or_else(PoisonError::into_inner).keep(kind, grad);
    }
}

#[derive(Clone, Debug)]
struct CompositeState<B: Backend> {
    input: CompositeInput<B>,
    image: FloatTensor<B>,
    gaussian_weight: FloatTensor<B>,
    options: CompositeOptions,
    arrived: Arrived<B>,
}

/// Goes back from all outputs of a call.
#[derive(Debug)]
struct CompositeBackward;

impl<B: CompositeBackwardOps> Backward<B, 3> for CompositeBackward {
    type State = CompositeState<B>;

    fn backward(self, ops: Ops<Self::State, 3>, grads: &mut Gradients, _: &mut Checkpointer) {
        let CompositeState { input, image, gaussian_weight, options, arrived } = ops.state;
        let of_outputs = std::mem::take(&mut *arrived.lock().unwrap_or_else(PoisonError::into_inner));
        let reached = of_outputs.reached();
        let (colours, sums) = (input.colours.clone(), input.sums.clone());
        let out = B::composite_backward(input, image, gaussian_weight, of_outputs, options);
        // the tape expects a gradient for all that is on it
        let zeros = |like: FloatTensor<B>| B::float_zeros(like.shape(), &like.device(), like.dtype().into());
        let [of_alpha, of_colours, of_sums] = ops.parents;
        if let Some(parent) = of_alpha {
            grads.register::<B>(parent.id, out.alpha);
        }
        if let Some(parent) = of_colours {
            grads.register::<B>(parent.id, if reached.colours() { out.colours } else { zeros(colours) });
        }
        if let Some(parent) = of_sums {
            grads.register::<B>(parent.id, if reached.sums() { out.sums } else { zeros(sums) });
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
                let arrived = arrived.clone();
                let state = CompositeState { input, image, gaussian_weight, options, arrived };
                prep.finish(state, out.gaussian_weight.clone())
            }
            OpsKind::UnTracked(prep) => prep.finish(out.gaussian_weight.clone()),
        };
        let output = |value: FloatTensor<B>, kind: OutputKind| {
            let node = call.clone().into_parts().1;
            match OutputBackward.prepare::<S>([node]).compute_bound().stateful() {
                OpsKind::Tracked(prep) => prep.finish(OutputState { kind, arrived: arrived.clone() }, value),
                OpsKind::UnTracked(prep) => prep.finish(value),
            }
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
