//! The attributes of a scene as Burn tensors on one device.

use burn::tensor::activation::sigmoid;
use burn::tensor::{DType, Device, Int, Tensor, TensorData};

use super::schema::{self, Attribute, Columns, GaussianColumns, OpacityActivation, SurfelColumns, Width};
use super::{ColourModel, GaussianData, SurfelData, split};
use crate::backend::host::copied;
use crate::counters::transfers::{download, upload, uploaded, wait};
use crate::error::{Error, Result};

/// View-dependent colour of N primitives; each column is [N, its width].
pub type Colour = schema::Colour<Tensor<2>>;
/// N surfels; each column is [N, its width].
pub type Surfels = SurfelColumns<Tensor<2>>;
/// M Gaussians; each column is [M, its width].
pub type Gaussians = GaussianColumns<Tensor<2>>;

/// [N, `width`] tensor of `dtype` from rows in host memory.
pub fn rows_to_tensor(rows: &[f32], width: usize, device: &Device, dtype: DType) -> Tensor<2> {
    let count = rows.len().checked_div(width).unwrap_or(0);
    uploaded(rows.to_vec(), [count, width], device, dtype)
}

/// The values of a tensor as `f32`, row-major.
pub fn tensor_to_rows<const D: usize>(tensor: &Tensor<D>) -> Vec<f32> {
    let data = wait(|| download(copied(tensor).unwrap_or_else(|| tensor.clone().into_data())));
    data.convert::<f32>().try_into_vec().expect("just converted to f32")
}

/// The detail of `colour`, row-major, from one tensor or several.
pub fn detail_to_rows(colour: &Colour) -> Vec<f32> {
    split::join(colour.details().map(|part| (tensor_to_rows(part), part.dims()[1])).collect())
}

/// A [N, 1] column as a vector `[N]`.
pub fn flat(column: &Tensor<2>) -> Tensor<1> {
    column.clone().reshape([column.dims()[0]])
}

impl Attribute {
    /// The raw numbers `rows` of `count` primitives as a tensor.
    pub fn tensor(&self, rows: &[f32], count: usize, model: ColourModel, device: &Device, dtype: DType) -> Tensor<2> {
        uploaded(rows.to_vec(), self.shape(count, model), device, dtype)
    }
}

impl OpacityActivation {
    /// [M, 1] opacities from raw ones, on the tape if these are.
    pub fn activate(self, raw: Tensor<2>) -> Tensor<2> {
        match self {
            Self::Linear => raw,
            Self::Sigmoid => sigmoid(raw),
            Self::Tanh => raw.tanh(),
        }
    }
}

macro_rules! on_a_device {
    ($tensors:ident, $data:ident) => {
        impl $tensors {
            /// The detail is [split](super::split) where no buffer of the device holds it.
            pub fn from_data(data: &$data, device: &Device, dtype: DType) -> Self {
                let (count, model) = (data.len(), data.model());
                let mut rest = Vec::new();
                let mut tensors = data.map_ref(|attribute, rows| {
                    let widths = split::widths(attribute, attribute.shape(count, model), device);
                    if widths.len() == 1 {
                        return attribute.tensor(rows, count, model, device, dtype);
                    }
                    let parts = split::split(rows, &widths).into_iter().zip(widths);
                    let mut parts = parts.map(|(rows, width)| uploaded(rows, [count, width], device, dtype));
                    let first = parts.next().expect("several parts");
                    rest = parts.collect();
                    first
                });
                tensors.colour.rest = rest;
                tensors
            }

            pub fn to_data(&self) -> $data {
                let mut data = self.map_ref(|_, tensor| tensor_to_rows(tensor));
                data.colour.rest.clear();
                data.colour.detail = detail_to_rows(&self.colour);
                data
            }

            pub fn len(&self) -> usize {
                self.positions.dims()[0]
            }

            pub fn is_empty(&self) -> bool {
                self.len() == 0
            }

            /// Every attribute that learns as a leaf of a tape.
            #[must_use]
            pub fn require_grad(self) -> Self {
                self.map(|attribute, tensor| if attribute.learns() { tensor.require_grad() } else { tensor })
            }

            /// # Errors
            /// [`Error::Shape`] naming the tensor that does not fit the others.
            pub fn check_shapes(&self) -> Result<()> {
                let (count, model) = (self.len(), self.model());
                let of_rest: usize = self.colour.rest.iter().map(|tensor| tensor.dims()[1]).sum();
                self.iter().try_for_each(|(attribute, tensor)| {
                    let [count, width] = attribute.shape(count, model);
                    let elsewhere = if attribute.width == Width::Detail { of_rest } else { 0 };
                    check_shape(attribute.name, tensor, [count, width.saturating_sub(elsewhere)])
                })
            }
        }
    };
}

on_a_device!(Surfels, SurfelData);
on_a_device!(Gaussians, GaussianData);

/// # Errors
/// [`Error::Shape`] if `tensor` does not have shape `expected`.
pub fn check_shape<const D: usize>(name: &str, tensor: &Tensor<D>, expected: [usize; D]) -> Result<()> {
    if tensor.dims() == expected {
        return Ok(());
    }
    Err(Error::Shape { tensor: name.to_owned(), expected: format!("{expected:?}"), found: tensor.dims().to_vec() })
}

/// `[rows]` integer tensor of row numbers, for `Tensor::select`.
pub fn row_indices(rows: &[usize], device: &Device) -> Tensor<1, Int> {
    let rows: Vec<i64> = rows.iter().map(|&row| row as i64).collect();
    let count = rows.len();
    Tensor::from_data(upload(TensorData::new(rows, [count])), device)
}
