//! `colour` on the tape.

use burn::backend::autodiff::checkpoint::strategy::CheckpointStrategy;
use burn::backend::tensor::FloatTensor;
use burn::backend::{Autodiff, Backend};

use super::{ColourOps, DetailPart};
use crate::backend::tape::{BackwardState, on_tape};

#[derive(Clone, Debug)]
pub struct ColourState<B: Backend> {
    pub detail: FloatTensor<B>,
    pub positions: FloatTensor<B>,
    pub centre: [f64; 3],
    pub part: DetailPart,
}

impl<B: ColourOps, S: CheckpointStrategy> ColourOps for Autodiff<B, S>
where
    ColourState<B>: BackwardState<B, 2>,
{
    fn colour(
        base: FloatTensor<Self>,
        detail: FloatTensor<Self>,
        positions: FloatTensor<Self>,
        centre: [f64; 3],
        part: DetailPart,
    ) -> FloatTensor<Self> {
        let (base, base_node) = base.into_parts();
        let (detail, detail_node) = detail.into_parts();
        let positions = positions.into_parts().0;
        on_tape::<B, S, _, _>([base_node, detail_node], |_| {
            let out = B::colour(base, detail.clone(), positions.clone(), centre, part);
            (out, ColourState { detail, positions, centre, part })
        })
    }
}
