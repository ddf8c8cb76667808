//! `first_non_finite` on the tape: no gradient.

use burn::backend::Autodiff;
use burn::backend::autodiff::checkpoint::strategy::CheckpointStrategy;
use burn::backend::tensor::{FloatTensor, IntTensor};

use super::FiniteOps;

impl<B: FiniteOps, S: CheckpointStrategy> FiniteOps for Autodiff<B, S> {
    fn first_non_finite(tensor: FloatTensor<Self>) -> IntTensor<Self> {
        B::first_non_finite(tensor.into_parts().0)
    }
}
