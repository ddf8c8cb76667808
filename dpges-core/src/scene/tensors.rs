//! The parameters of a scene as Burn tensors on one device.

use burn::tensor::{DType, Device, Int, Tensor, TensorData};

use super::{ColourData, ColourModel, GaussianData, SurfelData};
use crate::error::{Error, Result};

/// View-dependent colour of N primitives.
#[derive(Clone, Debug)]
pub struct Colour {
    pub model: ColourModel,
    /// [N, 3]
    pub base: Tensor<2>,
    /// [N, [`ColourModel::detail_len`]]
    pub detail: Tensor<2>,
}

/// N surfels; the fields mean what they mean in [`SurfelData`].
#[derive(Clone, Debug)]
pub struct Surfels {
    /// [N, 3]
    pub positions: Tensor<2>,
    /// [N, 4]
    pub quaternions: Tensor<2>,
    /// [N, 2]
    pub log_scales: Tensor<2>,
    pub colour: Colour,
    /// `[N]`, never carries a gradient
    pub margins: Tensor<1>,
}

/// M Gaussians; the fields mean what they mean in [`GaussianData`].
#[derive(Clone, Debug)]
pub struct Gaussians {
    /// [M, 3]
    pub positions: Tensor<2>,
    /// [M, 4]
    pub quaternions: Tensor<2>,
    /// [M, 3]
    pub log_scales: Tensor<2>,
    /// `[M]`
    pub opacities: Tensor<1>,
    pub colour: Colour,
}

/// [N, `width`] tensor of `dtype` from rows in host memory.
pub fn rows_to_tensor(rows: &[f32], width: usize, device: &Device, dtype: DType) -> Tensor<2> {
    let count = rows.len().checked_div(width).unwrap_or(0);
    Tensor::from_data(TensorData::new(rows.to_vec(), [count, width]).convert_dtype(dtype), (device, dtype))
}

/// The values of a tensor as `f32`, row-major.
pub fn tensor_to_rows<const D: usize>(tensor: &Tensor<D>) -> Vec<f32> {
    let data = tensor.clone().into_data();
    data.convert::<f32>().try_to_vec().expect("just converted to f32")
}

impl Colour {
    fn from_data(data: &ColourData, count: usize, model: ColourModel, device: &Device, dtype: DType) -> Self {
        let width = model.detail_len();
        let detail = TensorData::new(data.detail.clone(), [count, width]).convert_dtype(dtype);
        Self {
            model,
            base: rows_to_tensor(&data.base, 3, device, dtype),
            detail: Tensor::from_data(detail, (device, dtype)),
        }
    }

    fn to_data(&self) -> ColourData {
        ColourData { base: tensor_to_rows(&self.base), detail: tensor_to_rows(&self.detail) }
    }

    fn check(&self, of: &str, count: usize) -> Result<()> {
        check_shape(&format!("{of}.colour.base"), &self.base, [count, 3])?;
        check_shape(&format!("{of}.colour.detail"), &self.detail, [count, self.model.detail_len()])
    }
}

impl Surfels {
    pub fn from_data(data: &SurfelData, model: ColourModel, device: &Device, dtype: DType) -> Self {
        Self {
            positions: rows_to_tensor(&data.positions, 3, device, dtype),
            quaternions: rows_to_tensor(&data.quaternions, 4, device, dtype),
            log_scales: rows_to_tensor(&data.log_scales, 2, device, dtype),
            colour: Colour::from_data(&data.colour, data.len(), model, device, dtype),
            margins: rows_to_tensor(&data.margins, 1, device, dtype).reshape([data.len()]),
        }
    }

    pub fn to_data(&self) -> SurfelData {
        SurfelData {
            positions: tensor_to_rows(&self.positions),
            quaternions: tensor_to_rows(&self.quaternions),
            log_scales: tensor_to_rows(&self.log_scales),
            colour: self.colour.to_data(),
            margins: tensor_to_rows(&self.margins),
        }
    }

    pub fn len(&self) -> usize {
        self.positions.dims()[0]
    }

    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// # Errors
    /// [`Error::Shape`] naming the tensor that does not fit the others.
    pub fn check_shapes(&self) -> Result<()> {
        let count = self.len();
        check_shape("surfels.positions", &self.positions, [count, 3])?;
        check_shape("surfels.quaternions", &self.quaternions, [count, 4])?;
        check_shape("surfels.log_scales", &self.log_scales, [count, 2])?;
        self.colour.check("surfels", count)?;
        check_shape("surfels.margins", &self.margins, [count])
    }
}

impl Gaussians {
    pub fn from_data(data: &GaussianData, model: ColourModel, device: &Device, dtype: DType) -> Self {
        Self {
            positions: rows_to_tensor(&data.positions, 3, device, dtype),
            quaternions: rows_to_tensor(&data.quaternions, 4, device, dtype),
            log_scales: rows_to_tensor(&data.log_scales, 3, device, dtype),
            opacities: rows_to_tensor(&data.opacities, 1, device, dtype).reshape([data.len()]),
            colour: Colour::from_data(&data.colour, data.len(), model, device, dtype),
        }
    }

    pub fn to_data(&self) -> GaussianData {
        GaussianData {
            positions: tensor_to_rows(&self.positions),
            quaternions: tensor_to_rows(&self.quaternions),
            log_scales: tensor_to_rows(&self.log_scales),
            opacities: tensor_to_rows(&self.opacities),
            colour: self.colour.to_data(),
        }
    }

    pub fn len(&self) -> usize {
        self.positions.dims()[0]
    }

    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// # Errors
    /// [`Error::Shape`] naming the tensor that does not fit the others.
    pub fn check_shapes(&self) -> Result<()> {
        let count = self.len();
        check_shape("gaussians.positions", &self.positions, [count, 3])?;
        check_shape("gaussians.quaternions", &self.quaternions, [count, 4])?;
        check_shape("gaussians.log_scales", &self.log_scales, [count, 3])?;
        check_shape("gaussians.opacities", &self.opacities, [count])?;
        self.colour.check("gaussians", count)
    }
}

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
    Tensor::from_data(TensorData::new(rows, [count]), device)
}
