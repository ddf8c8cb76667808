//! Several tensors as one input.

use burn::backend::tensor::FloatTensor;
use burn::backend::{Backend, Dispatch, ExtensionType};
#[cfg(feature = "gpu")]
use cubecl::prelude::*;

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
        let [first, second, third, fourth, fifth, sixth] =
            std::array::from_fn(|at| tensors[at.min(tensors.len() - 1)].clone());
        Self { first, second, third, fourth, fifth, sixth }
    }
}

/// A number of each tensor of a list, in kernels.
#[cfg(feature = "gpu")]
#[derive(CubeType, CubeLaunch, Clone, Copy)]
#[expand(derive(Clone, Copy))]
pub struct PerTensor {
    pub first: u32,
    pub second: u32,
    pub third: u32,
    pub fourth: u32,
    pub fifth: u32,
    pub sixth: u32,
}

#[cfg(feature = "gpu")]
impl PerTensor {
    pub fn launch(numbers: [usize; LIST_LENGTH]) -> PerTensorLaunch {
        let [first, second, third, fourth, fifth, sixth] = numbers.map(|number| number as u32);
        PerTensorLaunch::new(first, second, third, fourth, fifth, sixth)
    }
}
