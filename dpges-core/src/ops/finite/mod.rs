//! `first_non_finite`: the position of the first value of a tensor that is not a finite number.
//!
//! Any float tensor → `[1]` integer: position in row-major order of the first NaN or infinity, −1 if
//! there is none. Training checks every step with it.

mod backward;
mod cpu;
#[cfg(feature = "gpu")]
mod cube;
#[cfg(test)]
mod tests;

use burn::backend::tensor::{FloatTensor, IntTensor};
use burn::backend::{Backend, Dispatch, backend_extension};
use burn::tensor::{Int, Tensor};

use crate::counters::transfers::{download, wait};
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

/// Checks of several tensors. All are launched before the first result is read.
#[derive(Clone, Default)]
pub struct FiniteChecks {
    names: Vec<String>,
    positions: Vec<Tensor<1, Int>>,
    row_lens: Vec<usize>,
}

impl FiniteChecks {
    /// Launches the check of `tensor`.
    pub fn add<const D: usize>(&mut self, name: impl Into<String>, tensor: &Tensor<D>) {
        let position = Dispatch::first_non_finite(tensor.clone().into_dispatch());
        self.names.push(name.into());
        self.positions.push(Tensor::from_dispatch(position));
        self.row_lens.push(tensor.dims()[1..].iter().product::<usize>().max(1));
    }

    /// `[tensors]` position of the first bad value in each tensor, −1 if there is none.
    ///
    /// # Panics
    /// If nothing was added.
    pub fn positions(&self) -> Tensor<1, Int> {
        Tensor::cat(self.positions.clone(), 0)
    }
}

/// Reads the results of `checks`.
///
/// # Errors
/// [`Error::NonFinite`] with the name of the first tensor that holds a bad value, and its row (first dimension).
pub fn check_finite(checks: &FiniteChecks) -> Result<()> {
    if checks.names.is_empty() {
        return Ok(());
    }
    let positions = wait(|| download(checks.positions().into_data()));
    for ((name, row_len), position) in checks.names.iter().zip(&checks.row_lens).zip(positions.iter::<i64>()) {
        if let Ok(position) = usize::try_from(position) {
            return Err(Error::NonFinite { tensor: name.clone(), row: position / row_len });
        }
    }
    Ok(())
}
