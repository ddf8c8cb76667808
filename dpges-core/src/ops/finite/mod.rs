//! `first_non_finite`: where a tensor first holds a value that is not a finite number.
//!
//! Any float tensor → `[1]` integer: position in row-major order of the first NaN or infinity, −1 if
//! there is none. Checks that guard a training step are made with it.

mod cpu;
#[cfg(feature = "gpu")]
mod cube;
#[cfg(test)]
mod tests;

use burn::backend::autodiff::checkpoint::strategy::CheckpointStrategy;
use burn::backend::tensor::{FloatTensor, IntTensor};
use burn::backend::{Autodiff, Backend, Dispatch, backend_extension};
use burn::tensor::{Int, Tensor};

use crate::error::{Error, Result};

#[backend_extension(
    Cube: cfg(feature = "gpu"),
    NdArray: cfg(feature = "ndarray"),
    Flex: cfg(feature = "flex"),
    Autodiff
)]
pub trait FiniteOps: Backend {
    fn first_non_finite(tensor: FloatTensor<Self>) -> IntTensor<Self>;
}

impl<B: FiniteOps, S: CheckpointStrategy> FiniteOps for Autodiff<B, S> {
    fn first_non_finite(tensor: FloatTensor<Self>) -> IntTensor<Self> {
        B::first_non_finite(tensor.into_parts().0)
    }
}

/// Where each of several tensors first holds a bad value, all asked for before any answer is read.
#[derive(Clone, Default)]
pub struct FiniteChecks {
    names: Vec<String>,
    positions: Vec<Tensor<1, Int>>,
    row_lens: Vec<usize>,
}

impl FiniteChecks {
    pub fn add<const D: usize>(&mut self, name: impl Into<String>, tensor: &Tensor<D>) {
        let position = Dispatch::first_non_finite(tensor.clone().into_dispatch());
        self.names.push(name.into());
        self.positions.push(Tensor::from_dispatch(position));
        self.row_lens.push(tensor.dims()[1..].iter().product::<usize>().max(1));
    }

    /// `[tensors]` position of the first bad value in each tensor, −1 where there is none.
    ///
    /// # Panics
    /// If nothing was added.
    pub fn positions(&self) -> Tensor<1, Int> {
        Tensor::cat(self.positions.clone(), 0)
    }
}

/// # Errors
/// [`Error::NonFinite`] naming the first of the added tensors that holds a bad value, and the row
/// (first dimension).
pub fn check_finite(checks: &FiniteChecks) -> Result<()> {
    if checks.names.is_empty() {
        return Ok(());
    }
    let positions = checks.positions().into_data();
    for ((name, row_len), position) in checks.names.iter().zip(&checks.row_lens).zip(positions.iter::<i64>()) {
        if let Ok(position) = usize::try_from(position) {
            return Err(Error::NonFinite { tensor: name.clone(), row: position / row_len });
        }
    }
    Ok(())
}
