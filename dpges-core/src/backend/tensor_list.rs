//! Several tensors as one input.

use burn::backend::autodiff::checkpoint::strategy::CheckpointStrategy;
use burn::backend::tensor::FloatTensor;
use burn::backend::{Autodiff, Backend, Dispatch, ExtensionType};

/// Tensors of a list: with a buffer for what a kernel writes, as many as every GPU can bind.
pub const LIST_LENGTH: usize = 6;

/// Tensors of any shapes. Those beyond the number that comes with a list repeat others.
#[derive(ExtensionType, Debug, Clone)]
pub struct TensorList<B: Backend> {
    first: FloatTensor<B>,
    second: FloatTensor<B>,
    third: FloatTensor<B>,
    fourth: FloatTensor<B>,
    fifth: FloatTensor<B>,
    sixth: FloatTensor<B>,
}

impl<B: Backend> TensorList<B> {
    fn new([first, second, third, fourth, fifth, sixth]: [FloatTensor<B>; LIST_LENGTH]) -> Self {
        Self { first, second, third, fourth, fifth, sixth }
    }

    /// All of them, those beyond the number that comes with the list last.
    pub fn into_tensors(self) -> [FloatTensor<B>; LIST_LENGTH] {
        [self.first, self.second, self.third, self.fourth, self.fifth, self.sixth]
    }
}

impl TensorList<Dispatch> {
    /// # Panics
    /// Unless there are 1 to [`LIST_LENGTH`] tensors.
    pub fn of(tensors: &[FloatTensor<Dispatch>]) -> Self {
        assert!((1..=LIST_LENGTH).contains(&tensors.len()), "{} tensors in a list", tensors.len());
        Self::new(std::array::from_fn(|at| tensors[at.min(tensors.len() - 1)].clone()))
    }
}

impl<B: Backend, S: CheckpointStrategy> TensorList<Autodiff<B, S>> {
    /// The same off the tape.
    pub fn inner(self) -> TensorList<B> {
        TensorList::new(self.into_tensors().map(|tensor| tensor.into_parts().0))
    }
}
