//! `splat` on the tape.

use burn::backend::Autodiff;
use burn::backend::autodiff::checkpoint::base::Checkpointer;
use burn::backend::autodiff::checkpoint::strategy::CheckpointStrategy;
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::{Backward, Ops, OpsKind};
use burn::backend::tensor::FloatTensor;
use burn::backend::{AutodiffBackend, Backend, TensorMetadata};

use super::{SplatBackwardOps, SplatGradients, SplatOps};
use crate::backend::kept::Kept;
use crate::backend::tape::pass_back;
use crate::camera::Camera;
use crate::footprint::gaussian::tensors::GaussianTensors;
use crate::scene::ScreenFilter;

#[derive(Clone, Debug)]
struct SplatState<B: Backend> {
    gaussians: GaussianTensors<B>,
    limits: FloatTensor<B>,
    camera: Camera,
    filter: ScreenFilter,
    probed: bool,
    kept: Kept,
}

#[derive(Debug)]
struct SplatBackward;

impl<B: SplatBackwardOps> Backward<B, 6> for SplatBackward {
    type State = SplatState<B>;

    fn backward(self, ops: Ops<Self::State, 6>, grads: &mut Gradients, _: &mut Checkpointer) {
        pass_back::<B, _, 6>(ops, grads, |state, grad| {
            let SplatState { gaussians, limits, camera, filter, probed, kept } = state;
            let SplatGradients { gaussians, probe } =
                B::splat_backward(gaussians, limits, grad, camera, filter, probed, kept);
            let [positions, quaternions, log_scales, opacities, colours] = gaussians.into_array().map(Some);
            [positions, quaternions, log_scales, opacities, colours, probed.then_some(probe)]
        });
    }
}

impl<B: SplatOps + SplatBackwardOps, S: CheckpointStrategy> SplatOps for Autodiff<B, S> {
    fn splat(
        gaussians: GaussianTensors<Self>,
        probe: FloatTensor<Self>,
        limits: FloatTensor<Self>,
        camera: Camera,
        filter: ScreenFilter,
        _: Kept,
    ) -> FloatTensor<Self> {
        let values = gaussians.values();
        let limits = limits.into_parts().0;
        let probed = probe.shape()[0] > 0;
        let (probe_value, probe) = probe.into_parts();
        let [positions, quaternions, log_scales, opacities, colours] =
            gaussians.into_array().map(|tensor| tensor.into_parts().1);
        let parents = [positions, quaternions, log_scales, opacities, colours, probe];
        match SplatBackward.prepare::<S>(parents).compute_bound().stateful() {
            OpsKind::Tracked(prep) => {
                let kept = Kept::wanted();
                let out = B::splat(values.clone(), probe_value, limits.clone(), camera, filter, kept.clone());
                prep.finish(SplatState { gaussians: values, limits, camera, filter, probed, kept }, out)
            }
            OpsKind::UnTracked(prep) => {
                prep.finish(B::splat(values, probe_value, limits, camera, filter, Kept::default()))
            }
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
