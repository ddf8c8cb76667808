//! `interval_limits` on the tape: no gradient.

use burn::backend::autodiff::checkpoint::strategy::CheckpointStrategy;
use burn::backend::tensor::{FloatTensor, IntTensor};
use burn::backend::{Autodiff, AutodiffBackend};

use super::LimitOps;
use crate::scene::MarginLookup;

impl<B: LimitOps, S: CheckpointStrategy> LimitOps for Autodiff<B, S> {
    fn interval_limits(
        ids: IntTensor<Self>,
        alpha: FloatTensor<Self>,
        depth: FloatTensor<Self>,
        margins: FloatTensor<Self>,
        lookup: MarginLookup,
    ) -> FloatTensor<Self> {
        let [alpha, depth, margins] = [alpha, depth, margins].map(|tensor| tensor.into_parts().0);
        <Self as AutodiffBackend>::from_inner(B::interval_limits(ids, alpha, depth, margins, lookup))
    }
}
