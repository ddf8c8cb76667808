//! `blend` on the tape: one node for all planes, so that a loss on several of them goes back through
//! the primitives once.

use burn::backend::autodiff::checkpoint::base::Checkpointer;
use burn::backend::autodiff::checkpoint::strategy::CheckpointStrategy;
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::{Backward, Ops, OpsKind};
use burn::backend::tensor::FloatTensor;
use burn::backend::{Autodiff, AutodiffBackend, Backend};

use super::{BlendBackwardOps, BlendInput, BlendOps, BlendOptions, BlendOutput};
use crate::camera::Camera;

#[derive(Clone, Debug)]
struct BlendState<B: Backend> {
    input: BlendInput<B>,
    camera: Camera,
    options: BlendOptions,
}

#[derive(Debug)]
struct BlendBackward;

impl<B: BlendBackwardOps> Backward<B, 6> for BlendBackward {
    type State = BlendState<B>;

    fn backward(self, ops: Ops<Self::State, 6>, grads: &mut Gradients, _: &mut Checkpointer) {
        let grad = grads.consume::<B>(&ops.node);
        let BlendState { input, camera, options } = ops.state;
        let out = B::blend_backward(input, grad, camera, options);
        let out = [out.positions, out.quaternions, out.log_scales, out.opacities, out.colours, out.probe];
        for (parent, grad) in ops.parents.into_iter().zip(out) {
            if let Some(parent) = parent {
                grads.register::<B>(parent.id, grad);
            }
        }
    }
}

impl<B: BlendOps + BlendBackwardOps, S: CheckpointStrategy> BlendOps for Autodiff<B, S> {
    fn blend(input: BlendInput<Self>, camera: Camera, options: BlendOptions) -> BlendOutput<Self> {
        let inner = |tensor: &FloatTensor<Self>| tensor.clone().into_parts().0;
        let values = BlendInput {
            positions: inner(&input.positions),
            quaternions: inner(&input.quaternions),
            log_scales: inner(&input.log_scales),
            opacities: inner(&input.opacities),
            colours: inner(&input.colours),
            probe: inner(&input.probe),
        };
        let out = B::blend(values.clone(), camera, options);
        let BlendInput { positions, quaternions, log_scales, opacities, colours, probe } = input;
        let parents = [positions, quaternions, log_scales, opacities, colours, probe];
        let parents = parents.map(|tensor| tensor.into_parts().1);
        let planes = match BlendBackward.prepare::<S>(parents).compute_bound().stateful() {
            OpsKind::Tracked(prep) => prep.finish(BlendState { input: values, camera, options }, out.planes),
            OpsKind::UnTracked(prep) => prep.finish(out.planes),
        };
        BlendOutput { planes, median_depth: <Self as AutodiffBackend>::from_inner(out.median_depth) }
    }
}
