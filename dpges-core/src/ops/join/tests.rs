use burn::tensor::{DType, Tensor};

use super::join;
use crate::ops::fixtures::of_type;
use crate::testing::device;
use crate::testing::golden::values;

#[test]
fn parts_of_any_lengths_and_number_stay_in_order() {
    for dtype in [DType::F32, DType::F64] {
        for count in [1, 2, 6, 7, 13, 40] {
            let part = |length: usize, from: usize| {
                let numbers: Vec<f64> = (from..from + length).map(|number| number as f64).collect();
                of_type(&numbers, [length], &device(), dtype)
            };
            let lengths: Vec<usize> = (0..count).map(|at| [1, 3, 1, 2][at % 4]).collect();
            let starts = lengths.iter().scan(0, |sum, length| {
                *sum += length;
                Some(*sum - length)
            });
            let parts: Vec<Tensor<1>> = lengths.iter().zip(starts).map(|(&length, from)| part(length, from)).collect();
            let expected: Vec<f64> = (0..lengths.iter().sum()).map(|number: usize| number as f64).collect();
            assert_eq!(values(&join(&parts)), expected, "{count} parts of {dtype:?}");
        }
    }
}
