//! `peel` on the tape.

use burn::backend::Autodiff;
use burn::backend::autodiff::checkpoint::strategy::CheckpointStrategy;
use burn::backend::tensor::FloatTensor;

use super::{PeelOps, PeelOptions, PeelOutput, PeelState, SurfelShapes};
use crate::backend::tape::{BackwardOfAll, all_on_tape};
use crate::camera::Camera;

/// Gradients with respect to alpha and to depth.
pub type Grads<B> = [Option<FloatTensor<B>>; 2];

impl<B: PeelOps, S: CheckpointStrategy> PeelOps for Autodiff<B, S>
where
    PeelState<B>: BackwardOfAll<B, 3, 2>,
{
    fn peel(surfels: SurfelShapes<Self>, camera: Camera, options: PeelOptions) -> PeelOutput<Self> {
        let [positions, quaternions, log_scales, margins] = surfels.into_array();
        let nodes = [&positions, &quaternions, &log_scales].map(|tensor| tensor.clone().into_parts().1);
        let surfels =
            SurfelShapes::from_array([positions, quaternions, log_scales, margins].map(|tensor| tensor.into_parts().0));
        let PeelOutput { ids, alpha, depth } = B::peel(surfels.clone(), camera, options);
        let state = PeelState { surfels, ids: ids.clone(), camera, options };
        let [alpha, depth] = all_on_tape::<B, S, _, 3, 2>(nodes, [alpha, depth], state);
        PeelOutput { ids, alpha, depth }
    }
}
