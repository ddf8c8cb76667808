//! `first_non_finite`: where a tensor first holds a value that is not a finite number.
//!
//! Any float tensor → [1] integer: position in row-major order of the first NaN or infinity, −1 if
//! there is none. Checks that guard a training step are made with it.

mod cpu;
#[cfg(test)]
mod tests;

use burn::backend::autodiff::checkpoint::strategy::CheckpointStrategy;
use burn::backend::tensor::{FloatTensor, IntTensor};
use burn::backend::{Autodiff, Backend, Dispatch, backend_extension};
use burn::tensor::{Int, Tensor};

use crate::error::{Error, Result};

#[backend_extension(NdArray: cfg(feature = "ndarray"), Flex: cfg(feature = "flex"), Autodiff)]
pub trait FiniteOps: Backend {
    fn first_non_finite(tensor: FloatTensor<Self>) -> IntTensor<Self>;
}

impl<B: FiniteOps, S: CheckpointStrategy> FiniteOps for Autodiff<B, S> {
    fn first_non_finite(tensor: FloatTensor<Self>) -> IntTensor<Self> {
        B::first_non_finite(tensor.into_parts().0)
    }
}

/// # Errors
/// [`Error::NonFinite`] naming `name`, the row (first dimension) and the value.
pub fn check_finite<const D: usize>(name: &str, tensor: &Tensor<D>) -> Result<()> {
    let position = Tensor::<1, Int>::from_dispatch(Dispatch::first_non_finite(tensor.clone().into_dispatch()));
    let position = position.into_data().iter::<i64>().next().unwrap_or(-1);
    let Ok(position) = usize::try_from(position) else { return Ok(()) };
    let row_len = tensor.dims()[1..].iter().product::<usize>().max(1);
    let found = tensor.clone().into_data().iter::<f64>().nth(position).unwrap_or(f64::NAN);
    Err(Error::NonFinite { tensor: name.to_owned(), row: position / row_len, found })
}
