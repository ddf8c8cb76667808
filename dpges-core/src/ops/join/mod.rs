//! `join`: short tensors one after the other in one tensor, so that the numbers of a step are read at once. No gradient.

mod cpu;
#[cfg(feature = "gpu")]
mod cube;
#[cfg(test)]
mod tests;

use burn::backend::tensor::FloatTensor;
use burn::backend::{Backend, Dispatch, backend_extension};
use burn::tensor::Tensor;

use crate::backend::tensor_list::{LIST_LENGTH, TensorList};

#[backend_extension(Cube: cfg(feature = "gpu"), NdArray: cfg(feature = "ndarray"), Flex: cfg(feature = "flex"))]
pub trait JoinOps: Backend {
    /// `[total]` numbers of the first `count` tensors of `list`.
    fn join(#[extension_type] list: TensorList<Self>, count: usize) -> FloatTensor<Self>;
}

/// The numbers of all `parts`, `[n]` each, off the tape.
///
/// # Panics
/// If there are no parts.
pub fn join(parts: &[Tensor<1>]) -> Tensor<1> {
    assert!(!parts.is_empty(), "nothing to join");
    if let [part] = parts {
        return part.clone().inner();
    }
    let of_list = |parts: &[Tensor<1>]| -> Tensor<1> {
        if let [part] = parts {
            return part.clone();
        }
        let parts: Vec<_> = parts.iter().map(|part| part.clone().inner().into_dispatch()).collect();
        Tensor::from_dispatch(Dispatch::join(TensorList::of(&parts), parts.len()))
    };
    join(&parts.chunks(LIST_LENGTH).map(of_list).collect::<Vec<_>>())
}
