//! `splat` on the tape.

use burn::backend::autodiff::checkpoint::strategy::CheckpointStrategy;
use burn::backend::tensor::FloatTensor;
use burn::backend::{Autodiff, AutodiffBackend, Backend};

use super::{SplatInput, SplatOps, with_probe};
use crate::backend::kept::Kept;
use crate::backend::tape::{BackwardState, on_tape};
use crate::camera::Camera;
use crate::footprint::gaussian::tensors::GaussianTensors;
use crate::scene::ScreenFilter;

#[derive(Clone, Debug)]
pub struct SplatState<B: Backend> {
    pub input: SplatInput<B>,
    pub camera: Camera,
    pub filter: ScreenFilter,
    pub kept: Kept,
}

impl<B: SplatOps, S: CheckpointStrategy> SplatOps for Autodiff<B, S>
where
    SplatState<B>: BackwardState<B, 6>,
{
    fn splat(input: SplatInput<Self>, camera: Camera, filter: ScreenFilter, _: Kept) -> FloatTensor<Self> {
        let gaussians = input.gaussians.values();
        let parents = input.gaussians.into_array().map(|tensor| tensor.into_parts().1);
        let (probe, probe_node) = input.probe.into_parts();
        let input = SplatInput { gaussians, probe, limits: input.limits.into_parts().0 };
        on_tape::<B, S, _, _>(with_probe(parents, probe_node), |kept| {
            let out = B::splat(input.clone(), camera, filter, kept.clone());
            (out, SplatState { input, camera, filter, kept })
        })
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
