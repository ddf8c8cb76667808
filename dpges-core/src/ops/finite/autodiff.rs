//! `finite` on the tape: no gradients.

use burn::backend::autodiff::checkpoint::strategy::CheckpointStrategy;
use burn::backend::tensor::IntTensor;
use burn::backend::{Autodiff, AutodiffBackend};

use super::{FiniteOps, GateOutput};
use crate::backend::tensor_list::TensorList;

impl<B: FiniteOps, S: CheckpointStrategy> FiniteOps for Autodiff<B, S> {
    fn first_non_finite(
        list: TensorList<Self>,
        count: usize,
        positions: IntTensor<Self>,
        first: usize,
    ) -> IntTensor<Self> {
        B::first_non_finite(list.inner(), count, positions, first)
    }

    fn gate(positions: IntTensor<Self>) -> GateOutput<Self> {
        let GateOutput { open, bad } = B::gate(positions);
        let [open, bad] = [open, bad].map(<Self as AutodiffBackend>::from_inner);
        GateOutput { open, bad }
    }
}
