//! Several tensors as one input.

use burn::backend::autodiff::checkpoint::strategy::CheckpointStrategy;
use burn::backend::tensor::FloatTensor;
use burn::backend::{Autodiff, Backend, Dispatch, ExtensionType};

/// Tensors of a batch: with a buffer for what a kernel writes, as many as every GPU can bind.
pub const BATCH: usize = 6;

/// Tensors of any shapes. Those beyond the number that comes with a batch repeat others.
#[derive(ExtensionType, Debug, Clone)]
pub struct Batch<B: Backend> {
    first: FloatTensor<B>,
    second: FloatTensor<B>,
    third: FloatTensor<B>,
    fourth: FloatTensor<B>,
    fifth: FloatTensor<B>,
    sixth: FloatTensor<B>,
}

impl<B: Backend> Batch<B> {
    fn new([first, second, third, fourth, fifth, sixth]: [FloatTensor<B>; BATCH]) -> Self {
        Self { first, second, third, fourth, fifth, sixth }
    }

    /// All of them, those beyond the number that comes with the batch last.
    pub fn into_tensors(self) -> [FloatTensor<B>; BATCH] {
        [self.first, self.second, self.third, self.fourth, self.fifth, self.sixth]
    }
}

impl Batch<Dispatch> {
    /// # Panics
    /// Unless there are 1 to [`BATCH`] tensors.
    pub fn of(tensors: &[FloatTensor<Dispatch>]) -> Self {
        assert!((1..=BATCH).contains(&tensors.len()), "{} tensors in a batch", tensors.len());
        Self::new(std::array::from_fn(|at| tensors[at.min(tensors.len() - 1)].clone()))
    }
}

impl<B: Backend, S: CheckpointStrategy> Batch<Autodiff<B, S>> {
    /// The same off the tape.
    pub fn inner(self) -> Batch<B> {
        Batch::new(self.into_tensors().map(|tensor| tensor.into_parts().0))
    }
}
