//! `splat` on the tape.

use burn::backend::Autodiff;
use burn::backend::autodiff::checkpoint::base::Checkpointer;
use burn::backend::autodiff::checkpoint::strategy::CheckpointStrategy;
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::{Backward, Ops, OpsKind};
use burn::backend::tensor::FloatTensor;
use burn::backend::{AutodiffBackend, Backend};

use super::{SplatBackwardOps, SplatOps};
use crate::backend::tape::pass_back;
use crate::camera::Camera;
use crate::footprint::gaussian::tensors::GaussianTensors;

#[derive(Clone, Debug)]
struct SplatState<B: Backend> {
    gaussians: GaussianTensors<B>,
    limits: FloatTensor<B>,
    camera: Camera,
}

#[derive(Debug)]
struct SplatBackward;

impl<B: SplatBackwardOps> Backward<B, 5> for SplatBackward {
    type State = SplatState<B>;

    fn backward(self, ops: Ops<Self::State, 5>, grads: &mut Gradients, _: &mut Checkpointer) {
        pass_back::<B, _, 5>(ops, grads, |state, grad| {
            B::splat_backward(state.gaussians, state.limits, grad, state.camera).into_array().map(Some)
        });
    }
}

impl<B: SplatOps + SplatBackwardOps, S: CheckpointStrategy> SplatOps for Autodiff<B, S> {
    fn splat(gaussians: GaussianTensors<Self>, limits: FloatTensor<Self>, camera: Camera) -> FloatTensor<Self> {
        let values = gaussians.values();
        let limits = limits.into_parts().0;
        let out = B::splat(values.clone(), limits.clone(), camera);
        let parents = gaussians.into_array().map(|tensor| tensor.into_parts().1);
        match SplatBackward.prepare::<S>(parents).compute_bound().stateful() {
            OpsKind::Tracked(prep) => prep.finish(SplatState { gaussians: values, limits, camera }, out),
            OpsKind::UnTracked(prep) => prep.finish(out),
        }
    }

    fn splat_contributions(
        gaussians: GaussianTensors<Self>,
        limits: FloatTensor<Self>,
        gates: FloatTensor<Self>,
        camera: Camera,
    ) -> FloatTensor<Self> {
        let [limits, gates] = [limits, gates].map(|tensor| tensor.into_parts().0);
        let out = B::splat_contributions(gaussians.values(), limits, gates, camera);
        <Self as AutodiffBackend>::from_inner(out)
    }
}
