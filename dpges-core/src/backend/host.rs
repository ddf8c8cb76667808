//! Access to tensors of the CPU backends as slices, without copying where the backend allows it.

use std::borrow::Cow;

use burn::backend::tensor::{FloatTensor, IntTensor};
use burn::backend::{Backend, TensorMetadata};
#[cfg(feature = "ndarray")]
use burn::backend::{BackendTensor, DispatchTensorKind};
use burn::tensor::{Tensor, TensorData, read_sync};

use crate::backend::real::Real;

/// A backend whose tensors live in host memory.
pub trait Host: Backend {
    /// The elements, if they lie contiguously and are of type `T`.
    fn float_values<T: Real>(tensor: &FloatTensor<Self>) -> Option<&[T]>;

    /// The elements, if they lie contiguously and are `i32`.
    fn int_values(tensor: &IntTensor<Self>) -> Option<&[i32]>;
}

/// The elements of a float tensor, row-major.
pub fn floats<B: Host, T: Real>(tensor: &FloatTensor<B>) -> Cow<'_, [T]> {
    B::float_values(tensor).map(Cow::Borrowed).unwrap_or_else(|| {
        let data = read_sync(B::float_into_data(tensor.clone())).expect("tensors in host memory can be read");
        Cow::Owned(data.convert::<T>().try_to_vec().expect("just converted"))
    })
}

/// The elements of an integer tensor, row-major.
pub fn ints<B: Host>(tensor: &IntTensor<B>) -> Cow<'_, [i32]> {
    B::int_values(tensor).map(Cow::Borrowed).unwrap_or_else(|| {
        let data = read_sync(B::int_into_data(tensor.clone())).expect("tensors in host memory can be read");
        Cow::Owned(data.convert::<i32>().try_to_vec().expect("just converted"))
    })
}

/// The elements of a float tensor as a vector, moved out if nothing else shares them.
pub fn take_floats<B: Host, T: Real>(tensor: FloatTensor<B>) -> Vec<T> {
    let data = read_sync(B::float_into_data(tensor)).expect("tensors in host memory can be read");
    data.try_into_vec().expect("element type was matched by the caller")
}

/// The `f32` values of a tensor of burn-ndarray; `None` of others. Burn's `into_data` copies a tensor that is shared number by
/// number.
pub fn copied<const D: usize>(tensor: &Tensor<D>) -> Option<TensorData> {
    match tensor.clone().into_dispatch().kind {
        #[cfg(feature = "ndarray")]
        DispatchTensorKind::NdArray(BackendTensor::Float(values)) => {
            let values = burn::backend::NdArray::float_values::<f32>(&values)?;
            Some(TensorData::new(values.to_vec(), tensor.dims()))
        }
        _ => None,
    }
}

/// A float tensor of row-major `values`.
pub fn float_tensor<B: Backend, T: Real, const D: usize>(
    values: Vec<T>,
    shape: [usize; D],
    device: &B::Device,
) -> FloatTensor<B> {
    B::float_from_data(TensorData::new(values, shape), device)
}

/// An integer tensor of row-major `values`.
pub fn int_tensor<B: Backend, const D: usize>(values: Vec<i32>, shape: [usize; D], device: &B::Device) -> IntTensor<B> {
    B::int_from_data(TensorData::new(values, shape), device)
}

/// Number of rows (first dimension).
pub fn rows(tensor: &impl TensorMetadata) -> usize {
    tensor.shape()[0]
}

#[cfg(feature = "ndarray")]
impl Host for burn::backend::NdArray {
    fn float_values<T: Real>(tensor: &FloatTensor<Self>) -> Option<&[T]> {
        use burn::backend::ndarray::NdArrayTensor;
        match tensor {
            NdArrayTensor::F32(storage) if T::DTYPE == burn::tensor::DType::F32 => {
                storage.view().to_slice().map(bytemuck::cast_slice)
            }
            NdArrayTensor::F64(storage) if T::DTYPE == burn::tensor::DType::F64 => {
                storage.view().to_slice().map(bytemuck::cast_slice)
            }
            _ => None,
        }
    }

    fn int_values(tensor: &IntTensor<Self>) -> Option<&[i32]> {
        match tensor {
            burn::backend::ndarray::NdArrayTensor::I32(storage) => storage.view().to_slice(),
            _ => None,
        }
    }
}

#[cfg(feature = "flex")]
impl Host for burn::backend::Flex {
    fn float_values<T: Real>(tensor: &FloatTensor<Self>) -> Option<&[T]> {
        if tensor.dtype() == T::DTYPE { tensor.as_slice() } else { None }
    }

    fn int_values(tensor: &IntTensor<Self>) -> Option<&[i32]> {
        if tensor.dtype() == burn::tensor::DType::I32 { tensor.as_slice() } else { None }
    }
}

/// Evaluates `$body` with `$T` as an alias of the element type of a tensor. Public functions reject other element
/// types before they dispatch.
macro_rules! with_real {
    ($dtype:expr, $T:ident => $body:expr) => {
        match $dtype {
            burn::tensor::DType::F64 => {
                type $T = f64;
                $body
            }
            burn::tensor::DType::F32 => {
                type $T = f32;
                $body
            }
            other => unreachable!("element type {other:?} is refused before"),
        }
    };
}
pub(crate) use with_real;
