//! `blend` on the tape: all planes share one node, so that a loss on several planes passes through the primitives
//! once.

use burn::backend::autodiff::checkpoint::base::Checkpointer;
use burn::backend::autodiff::checkpoint::strategy::CheckpointStrategy;
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::{Backward, Ops, OpsKind};
use burn::backend::{Autodiff, AutodiffBackend, Backend};

use super::{BlendBackwardOps, BlendInput, BlendLists, BlendOps, BlendOptions, BlendOutput};
use crate::backend::kept::Kept;
use crate::backend::tape::pass_back;
use crate::camera::Camera;

#[derive(Clone, Debug)]
struct BlendState<B: Backend> {
    input: BlendInput<B>,
    lists: BlendLists<B>,
    camera: Camera,
    options: BlendOptions,
    kept: Kept,
}

#[derive(Debug)]
struct BlendBackward;

impl<B: BlendBackwardOps> Backward<B, 7> for BlendBackward {
    type State = BlendState<B>;

    fn backward(self, ops: Ops<Self::State, 7>, grads: &mut Gradients, _: &mut Checkpointer) {
        pass_back::<B, _, 7>(ops, grads, |BlendState { input, lists, camera, options, kept }, grad| {
            let BlendInput { gaussians, degrees_of_freedom, probe } =
                B::blend_backward(input, lists, grad, camera, options, kept);
            let [positions, quaternions, log_scales, opacities, colours] = gaussians.into_array();
            [positions, quaternions, log_scales, opacities, colours, degrees_of_freedom, probe].map(Some)
        });
    }
}

impl<B: BlendOps + BlendBackwardOps, S: CheckpointStrategy> BlendOps for Autodiff<B, S> {
    fn blend(input: BlendInput<Self>, camera: Camera, options: BlendOptions, _: Kept) -> BlendOutput<Self> {
        let BlendInput { gaussians, degrees_of_freedom, probe } = input;
        let values = BlendInput {
            gaussians: gaussians.values(),
            degrees_of_freedom: degrees_of_freedom.clone().into_parts().0,
            probe: probe.clone().into_parts().0,
        };
        let [positions, quaternions, log_scales, opacities, colours] = gaussians.into_array();
        let parents = [positions, quaternions, log_scales, opacities, colours, degrees_of_freedom, probe];
        let parents = parents.map(|tensor| tensor.into_parts().1);
        let (planes, median_depth, lists) = match BlendBackward.prepare::<S>(parents).compute_bound().stateful() {
            OpsKind::Tracked(prep) => {
                let kept = Kept::wanted();
                let BlendOutput { planes, median_depth, lists } =
                    B::blend(values.clone(), camera, options, kept.clone());
                let state = BlendState { input: values, lists: lists.clone(), camera, options, kept };
                (prep.finish(state, planes), median_depth, lists)
            }
            OpsKind::UnTracked(prep) => {
                let BlendOutput { planes, median_depth, lists } = B::blend(values, camera, options, Kept::default());
                (prep.finish(planes), median_depth, lists)
            }
        };
        let BlendLists { order, starts, pairs, primitives, offsets } = lists;
        let lists = BlendLists { order, starts, pairs, primitives, offsets };
        BlendOutput { planes, median_depth: <Self as AutodiffBackend>::from_inner(median_depth), lists }
    }
}
