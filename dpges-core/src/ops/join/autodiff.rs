//! `join` on the tape: no gradient.

use burn::backend::autodiff::checkpoint::strategy::CheckpointStrategy;
use burn::backend::tensor::FloatTensor;
use burn::backend::{Autodiff, AutodiffBackend};

use super::JoinOps;
use crate::backend::tensor_list::TensorList;

impl<B: JoinOps, S: CheckpointStrategy> JoinOps for Autodiff<B, S> {
    fn join(list: TensorList<Self>, count: usize) -> FloatTensor<Self> {
        <Self as AutodiffBackend>::from_inner(B::join(list.inner(), count))
    }
}
