//! `finite`: the positions of the first values of tensors that are not finite numbers.
//!
//! Any float tensors → an integer each: position in row-major order of the first NaN or infinity, −1 if there is none; and
//! a gate that is open if there is none in any. Training checks every step with it. No gradients.

mod cpu;
#[cfg(feature = "gpu")]
mod cube;
#[cfg(test)]
mod tests;

use burn::backend::tensor::{FloatTensor, IntTensor};
use burn::backend::{Backend, Dispatch, ExtensionType, backend_extension};
use burn::tensor::{DType, Device, Int, Tensor};

use crate::backend::tensor_list::{LIST_LENGTH, TensorList};
use crate::counters::transfers::{download, wait};
use crate::error::{Error, Result};

/// `[1]` each, f32
#[derive(ExtensionType, Debug, Clone)]
pub struct GateOutput<B: Backend> {
    pub open: FloatTensor<B>,
    pub bad: FloatTensor<B>,
}

#[backend_extension(Cube: cfg(feature = "gpu"), NdArray: cfg(feature = "ndarray"), Flex: cfg(feature = "flex"))]
pub trait FiniteOps: Backend {
    /// `positions` `[n]`, which are −1 so far, with those of the first `count` tensors of `list` from place `first` on.
    fn first_non_finite(
        #[extension_type] list: TensorList<Self>,
        count: usize,
        positions: IntTensor<Self>,
        first: usize,
    ) -> IntTensor<Self>;

    fn gate(positions: IntTensor<Self>) -> GateOutput<Self>;
}

/// Tensors to check.
#[derive(Default)]
pub struct FiniteChecks {
    /// Names, and numbers in a row.
    names: Vec<(String, usize)>,
    tensors: Vec<FloatTensor<Dispatch>>,
    /// The device of the first tensor.
    device: Option<Device>,
}

impl FiniteChecks {
    pub fn add<const D: usize>(&mut self, name: impl Into<String>, tensor: &Tensor<D>) {
        self.names.push((name.into(), tensor.dims()[1..].iter().product::<usize>().max(1)));
        self.device.get_or_insert_with(|| tensor.device().inner());
        self.tensors.push(tensor.clone().inner().into_dispatch());
    }

    /// Launches the checks, of several tensors at once.
    ///
    /// # Panics
    /// If nothing was added.
    pub fn launch(self) -> FiniteResults {
        let device = self.device.expect("a tensor to check");
        let none = Tensor::<1, Int>::full([self.tensors.len()], -1, (&device, DType::I32));
        let mut positions = none.into_dispatch();
        for (list, tensors) in self.tensors.chunks(LIST_LENGTH).enumerate() {
            positions =
                Dispatch::first_non_finite(TensorList::of(tensors), tensors.len(), positions, list * LIST_LENGTH);
        }
        FiniteResults { names: self.names, positions: Tensor::from_dispatch(positions) }
    }
}

/// The results of [`FiniteChecks`]. They stay on the device until they are read.
#[derive(Clone)]
pub struct FiniteResults {
    /// As in [`FiniteChecks`].
    names: Vec<(String, usize)>,
    /// `[tensors]`
    positions: Tensor<1, Int>,
}

/// Whether all tensors are finite, on their device; `[1]` each, f32.
#[derive(Clone, Debug)]
pub struct Gate {
    /// 1 if all are, else 0.
    pub open: Tensor<1>,
    /// Number of those that are not.
    pub bad: Tensor<1>,
}

impl FiniteResults {
    /// `[tensors]` position of the first bad value in each tensor, −1 if there is none.
    pub fn positions(&self) -> Tensor<1, Int> {
        self.positions.clone()
    }

    pub fn gate(&self) -> Gate {
        let GateOutput { open, bad } = Dispatch::gate(self.positions().into_dispatch());
        Gate { open: Tensor::from_dispatch(open), bad: Tensor::from_dispatch(bad) }
    }

    /// Reads the results.
    ///
    /// # Errors
    /// [`Error::NonFinite`] with the name of the first tensor that holds a bad value, and its row (first dimension).
    pub fn check(&self) -> Result<()> {
        let positions = wait(|| download(self.positions().into_data()));
        for ((name, row_len), position) in self.names.iter().zip(positions.iter::<i64>()) {
            if let Ok(position) = usize::try_from(position) {
                return Err(Error::NonFinite { tensor: name.clone(), row: position / row_len });
            }
        }
        Ok(())
    }
}

/// Launches `checks` and reads the results.
///
/// # Errors
/// The errors of [`FiniteResults::check`].
pub fn check_finite(checks: FiniteChecks) -> Result<()> {
    if checks.names.is_empty() { Ok(()) } else { checks.launch().check() }
}
