//! `splat` on the tape.

use burn::backend::Autodiff;
use burn::backend::autodiff::checkpoint::base::Checkpointer;
use burn::backend::autodiff::checkpoint::strategy::CheckpointStrategy;
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::{Backward, Ops, OpsKind};
use burn::backend::tensor::FloatTensor;
use burn::backend::{AutodiffBackend, Backend};

use super::{SplatBackwardOps, SplatInput, SplatOps};
use crate::camera::Camera;

#[derive(Clone, Debug)]
struct SplatState<B: Backend> {
    gaussians: SplatInput<B>,
    limits: FloatTensor<B>,
    camera: Camera,
}

#[derive(Debug)]
struct SplatBackward;

impl<B: SplatBackwardOps> Backward<B, 5> for SplatBackward {
    type State = SplatState<B>;

    fn backward(self, ops: Ops<Self::State, 5>, grads: &mut Gradients, _: &mut Checkpointer) {
        let grad = grads.consume::<B>(&ops.node);
        let state = ops.state;
        let out = B::splat_backward(state.gaussians, state.limits, grad, state.camera);
        let out = [out.positions, out.quaternions, out.log_scales, out.opacities, out.colours];
        for (parent, grad) in ops.parents.into_iter().zip(out) {
            if let Some(parent) = parent {
                grads.register::<B>(parent.id, grad);
            }
        }
    }
}

/// The same tensors without their nodes.
pub fn values<B: Backend, S: CheckpointStrategy>(gaussians: &SplatInput<Autodiff<B, S>>) -> SplatInput<B> {
    let inner = |tensor: &FloatTensor<Autodiff<B, S>>| tensor.clone().into_parts().0;
    SplatInput {
        positions: inner(&gaussians.positions),
        quaternions: inner(&gaussians.quaternions),
        log_scales: inner(&gaussians.log_scales),
        opacities: inner(&gaussians.opacities),
        colours: inner(&gaussians.colours),
    }
}

impl<B: SplatOps + SplatBackwardOps, S: CheckpointStrategy> SplatOps for Autodiff<B, S> {
    fn splat(gaussians: SplatInput<Self>, limits: FloatTensor<Self>, camera: Camera) -> FloatTensor<Self> {
        let inner = values(&gaussians);
        let limits = limits.into_parts().0;
        let out = B::splat(inner.clone(), limits.clone(), camera);
        let SplatInput { positions, quaternions, log_scales, opacities, colours } = gaussians;
        let parents = [positions, quaternions, log_scales, opacities, colours].map(|tensor| tensor.into_parts().1);
        match SplatBackward.prepare::<S>(parents).compute_bound().stateful() {
            OpsKind::Tracked(prep) => prep.finish(SplatState { gaussians: inner, limits, camera }, out),
            OpsKind::UnTracked(prep) => prep.finish(out),
        }
    }

    fn splat_contributions(
        gaussians: SplatInput<Self>,
        limits: FloatTensor<Self>,
        gates: FloatTensor<Self>,
        camera: Camera,
    ) -> FloatTensor<Self> {
        let out = B::splat_contributions(values(&gaussians), limits.into_parts().0, gates.into_parts().0, camera);
        <Self as AutodiffBackend>::from_inner(out)
    }
}
