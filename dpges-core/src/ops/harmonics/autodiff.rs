//! `harmonics` on the tape.

use burn::backend::autodiff::checkpoint::strategy::CheckpointStrategy;
use burn::backend::tensor::FloatTensor;
use burn::backend::{Autodiff, Backend, TensorMetadata};

use super::HarmonicsOps;
use crate::backend::tape::{BackwardState, on_tape};

#[derive(Clone, Debug)]
pub struct HarmonicsState<B: Backend> {
    pub positions: FloatTensor<B>,
    pub centre: [f64; 3],
    /// Numbers of a detail.
    pub higher: usize,
}

impl<B: HarmonicsOps, S: CheckpointStrategy> HarmonicsOps for Autodiff<B, S>
where
    HarmonicsState<B>: BackwardState<B, 2>,
{
    fn harmonics(
        base: FloatTensor<Self>,
        detail: FloatTensor<Self>,
        positions: FloatTensor<Self>,
        centre: [f64; 3],
    ) -> FloatTensor<Self> {
        let (base, base_node) = base.into_parts();
        let (detail, detail_node) = detail.into_parts();
        let positions = positions.into_parts().0;
        let higher = detail.shape()[1];
        on_tape::<B, S, _, _>([base_node, detail_node], |_| {
            let out = B::harmonics(base, detail, positions.clone(), centre);
            (out, HarmonicsState { positions, centre, higher })
        })
    }
}
