//! `peel` on the tape: alpha and depth have separate nodes over one forward pass, so that a loss that uses
//! one of them does not pay for the other.

use burn::backend::autodiff::checkpoint::base::Checkpointer;
use burn::backend::autodiff::checkpoint::strategy::CheckpointStrategy;
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::{Backward, Ops, OpsKind};
use burn::backend::tensor::{FloatTensor, IntTensor};
use burn::backend::{Autodiff, Backend};

use super::{PeelBackwardOps, PeelGradient, PeelOps, PeelOptions, PeelOutput, SurfelShapes};
use crate::backend::tape::pass_back;
use crate::camera::Camera;

#[derive(Clone, Debug)]
struct PeelState<B: Backend> {
    surfels: SurfelShapes<B>,
    ids: IntTensor<B>,
    of: PeelGradient,
    camera: Camera,
    options: PeelOptions,
}

#[derive(Debug)]
struct PeelBackward;

impl<B: PeelBackwardOps> Backward<B, 3> for PeelBackward {
    type State = PeelState<B>;

    fn backward(self, ops: Ops<Self::State, 3>, grads: &mut Gradients, _: &mut Checkpointer) {
        pass_back::<B, _, 3>(ops, grads, |PeelState { surfels, ids, of, camera, options }, grad| {
            let out = B::peel_backward(surfels, ids, grad, of, camera, options);
            [out.positions, out.quaternions, out.log_scales].map(Some)
        });
    }
}

impl<B: PeelOps + PeelBackwardOps, S: CheckpointStrategy> PeelOps for Autodiff<B, S> {
    fn peel(surfels: SurfelShapes<Self>, camera: Camera, options: PeelOptions) -> PeelOutput<Self> {
        let inner = |tensor: &FloatTensor<Self>| tensor.clone().into_parts().0;
        let values = SurfelShapes {
            positions: inner(&surfels.positions),
            quaternions: inner(&surfels.quaternions),
            log_scales: inner(&surfels.log_scales),
        };
        let out = B::peel(values.clone(), camera, options);
        let node = |value: FloatTensor<B>, of: PeelGradient| {
            let parents = [&surfels.positions, &surfels.quaternions, &surfels.log_scales];
            let parents = parents.map(|tensor| tensor.clone().into_parts().1);
            match PeelBackward.prepare::<S>(parents).compute_bound().stateful() {
                OpsKind::Tracked(prep) => {
                    let ids = out.ids.clone();
                    prep.finish(PeelState { surfels: values.clone(), ids, of, camera, options }, value)
                }
                OpsKind::UnTracked(prep) => prep.finish(value),
            }
        };
        let (alpha, depth) = (node(out.alpha, PeelGradient::Alpha), node(out.depth, PeelGradient::Depth));
        PeelOutput { ids: out.ids, alpha, depth }
    }
}
