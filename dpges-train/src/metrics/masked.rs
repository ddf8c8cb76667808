//! Small pictures in which some pixels do not count.

use burn::tensor::{DType, Tensor, TensorData};
use dpges_core::losses::{Mask, Target};
use dpges_core::testing::device;

const WIDTH: usize = 23;
const HEIGHT: usize = 19;
pub const AREA: usize = WIDTH * HEIGHT;

/// A rectangle in the middle and a column at the border do not count.
pub fn counted() -> Vec<bool> {
    let is_ignored = |x: usize, y: usize| ((6..15).contains(&x) && (4..12).contains(&y)) || x + 1 == WIDTH;
    (0..AREA).map(|at| !is_ignored(at % WIDTH, at / WIDTH)).collect()
}

/// [3, H, W] in f64.
pub fn image(values: &[f64]) -> Tensor<3> {
    Tensor::from_data(TensorData::new(values.to_vec(), [3, HEIGHT, WIDTH]), (&device(), DType::F64))
}

pub fn target(values: &[f64], counted: &[bool]) -> Target {
    Target { image: image(values), mask: Some(Mask::new(counted, WIDTH, HEIGHT, &device()).unwrap()) }
}

/// `values` [3 × H × W] with `others` where pixels do not count.
pub fn overpainted(values: &[f64], others: &[f64]) -> Vec<f64> {
    let counted = counted();
    (0..3 * AREA).map(|at| if counted[at % AREA] { values[at] } else { others[at] }).collect()
}
