//! Tensors of small pictures in which some pixels do not count.

use burn::tensor::{DType, Tensor, TensorData};
use dpges_core::losses::Target;
use dpges_core::testing::device;
pub use dpges_core::testing::masked::{AREA, counted, overpainted};
use dpges_core::testing::masked::{HEIGHT, WIDTH, mask};

/// [3, H, W] in f64.
pub fn image(values: &[f64]) -> Tensor<3> {
    Tensor::from_data(TensorData::new(values.to_vec(), [3, HEIGHT, WIDTH]), (&device(), DType::F64))
}

pub fn target(values: &[f64], counted: &[bool]) -> Target {
    Target { image: image(values), mask: Some(mask(counted)) }
}
