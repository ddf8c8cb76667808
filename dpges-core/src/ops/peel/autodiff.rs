//! `peel` on the tape: alpha and depth have separate nodes over one forward pass, so that a loss that uses
//! one of them does not pay for the other.

use burn::backend::autodiff::checkpoint::strategy::CheckpointStrategy;
use burn::backend::tensor::{FloatTensor, IntTensor};
use burn::backend::{Autodiff, Backend};

use super::{PeelGradient, PeelOps, PeelOptions, PeelOutput, SurfelShapes};
use crate::backend::tape::{WayBack, on_tape};
use crate::camera::Camera;

#[derive(Clone, Debug)]
pub struct PeelState<B: Backend> {
    pub surfels: SurfelShapes<B>,
    pub ids: IntTensor<B>,
    pub of: PeelGradient,
    pub camera: Camera,
    pub options: PeelOptions,
}

impl<B: PeelOps, S: CheckpointStrategy> PeelOps for Autodiff<B, S>
where
    PeelState<B>: WayBack<B, 3>,
{
    fn peel(surfels: SurfelShapes<Self>, camera: Camera, options: PeelOptions) -> PeelOutput<Self> {
        let tensors = surfels.into_array();
        let values = SurfelShapes::from_array(tensors.clone().map(|tensor| tensor.into_parts().0));
        let PeelOutput { ids, alpha, depth } = B::peel(values.clone(), camera, options);
        let node = |value: FloatTensor<B>, of: PeelGradient| {
            let parents = tensors.clone().map(|tensor| tensor.into_parts().1);
            let state = PeelState { surfels: values.clone(), ids: ids.clone(), of, camera, options };
            on_tape::<B, S, _, _>(parents, |_| (value, state))
        };
        let (alpha, depth) = (node(alpha, PeelGradient::Alpha), node(depth, PeelGradient::Depth));
        PeelOutput { ids, alpha, depth }
    }
}
