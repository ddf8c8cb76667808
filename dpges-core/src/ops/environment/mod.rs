//! `environment`: the colour of what lies at infinity, in the direction of every pixel.
//!
//! Coefficients [(degree + 1)², 3] of spherical harmonics and a camera → `E(v) = Σ c_k Y_k(v)` [3, H, W], not clamped.
//! v is the unit vector in world axes along the ray through the centre of a pixel; the harmonics are those of the
//! colour model (3DGS). Pixels where a lens shows nothing are 0.
//!
//! Gradient: to the coefficients.

mod autodiff;
mod cpu;
#[cfg(feature = "gpu")]
mod cube;
#[cfg(test)]
mod tests;
pub mod turn;

use burn::backend::tensor::FloatTensor;
use burn::backend::{Backend, Dispatch, backend_extension};
use burn::tensor::{DType, Tensor};

use crate::camera::Camera;
use crate::error::{Error, Result};
use crate::scene::EnvironmentData;
use crate::scene::schema::ENVIRONMENT;

#[backend_extension(
    Cube: cfg(feature = "gpu"),
    NdArray: cfg(feature = "ndarray"),
    Flex: cfg(feature = "flex"),
    Autodiff
)]
pub trait EnvironmentOps: Backend {
    fn environment(coefficients: FloatTensor<Self>, camera: Camera) -> FloatTensor<Self>;
}

/// The environment [3, H, W] with `coefficients` [(degree + 1)², 3], seen by `camera`.
///
/// # Errors
/// [`Error::Shape`] if the number of coefficients is that of no degree from 0 to 3, [`Error::DType`] if they are neither
/// f32 nor f64.
pub fn environment(coefficients: &Tensor<2>, camera: &Camera) -> Result<Tensor<3>> {
    let [count, width] = coefficients.dims();
    if width != 3 || EnvironmentData::degree_of(count).is_none() {
        let (tensor, expected) = (ENVIRONMENT.name.to_owned(), EnvironmentData::EXPECTED_SHAPE.to_owned());
        return Err(Error::Shape { tensor, expected, found: vec![count, width] });
    }
    let dtype = coefficients.dtype();
    if !matches!(dtype, DType::F32 | DType::F64) {
        let (tensor, expected) = (ENVIRONMENT.name.to_owned(), "F32 or F64".to_owned());
        return Err(Error::DType { tensor, expected, found: format!("{dtype:?}") });
    }
    let image = Dispatch::environment(coefficients.clone().into_dispatch(), *camera);
    Ok(Tensor::from_dispatch(image))
}
