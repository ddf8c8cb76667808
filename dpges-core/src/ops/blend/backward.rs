//! `blend` on the tape: colour, alpha and depth are separate nodes over the same forward pass, so
//! that a loss pays for those that it uses.

use burn::backend::autodiff::checkpoint::base::Checkpointer;
use burn::backend::autodiff::checkpoint::strategy::CheckpointStrategy;
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::{Backward, Ops, OpsKind};
use burn::backend::tensor::FloatTensor;
use burn::backend::{Autodiff, AutodiffBackend, Backend};

use super::{BlendBackwardOps, BlendOps, BlendOptions, BlendOutput, OutputKind};
use crate::camera::Camera;
use crate::ops::splat::{self, SplatInput};

#[derive(Clone, Debug)]
struct BlendState<B: Backend> {
    gaussians: SplatInput<B>,
    kind: OutputKind,
    camera: Camera,
    options: BlendOptions,
}

#[derive(Debug)]
struct BlendBackward;

impl<B: BlendBackwardOps> Backward<B, 5> for BlendBackward {
    type State = BlendState<B>;

    fn backward(self, ops: Ops<Self::State, 5>, grads: &mut Gradients, _: &mut Checkpointer) {
        let grad = grads.consume::<B>(&ops.node);
        let BlendState { gaussians, kind, camera, options } = ops.state;
        let out = B::blend_backward(gaussians, grad, kind, camera, options);
        let reached = [
            (out.positions, true),
            (out.quaternions, true),
            (out.log_scales, true),
            (out.opacities, true),
            (out.colours, kind.reaches_colours()),
        ];
        for (parent, (grad, reached)) in ops.parents.into_iter().zip(reached) {
            if let (Some(parent), true) = (parent, reached) {
                grads.register::<B>(parent.id, grad);
            }
        }
    }
}

impl<B: BlendOps + BlendBackwardOps, S: CheckpointStrategy> BlendOps for Autodiff<B, S> {
    fn blend(gaussians: SplatInput<Self>, camera: Camera, options: BlendOptions) -> BlendOutput<Self> {
        let values = splat::values(&gaussians);
        let out = B::blend(values.clone(), camera, options);
        let node = |value: FloatTensor<B>, kind: OutputKind| {
            let SplatInput { positions, quaternions, log_scales, opacities, colours } = &gaussians;
            let parents = [positions, quaternions, log_scales, opacities, colours];
            let parents = parents.map(|tensor| tensor.clone().into_parts().1);
            match BlendBackward.prepare::<S>(parents).compute_bound().stateful() {
                OpsKind::Tracked(prep) => {
                    prep.finish(BlendState { gaussians: values.clone(), kind, camera, options }, value)
                }
                OpsKind::UnTracked(prep) => prep.finish(value),
            }
        };
        BlendOutput {
            colour: node(out.colour, OutputKind::Colour),
            alpha: node(out.alpha, OutputKind::Alpha),
            depth: node(out.depth, OutputKind::Depth),
            median_depth: <Self as AutodiffBackend>::from_inner(out.median_depth),
        }
    }
}
