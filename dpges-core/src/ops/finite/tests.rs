use burn::tensor::{DType, Tensor, TensorData};

use super::check_finite;
use crate::error::Error;
use crate::testing::device;

fn first(count: usize, bad: &[(usize, f64)], dtype: DType) -> Option<(usize, f64)> {
    let mut values: Vec<f64> = (0..count * 3).map(|i| f64::from(i as f32).sin() * 1e30).collect();
    bad.iter().for_each(|&(at, value)| values[at] = value);
    let data = TensorData::new(values, [count, 3]).convert_dtype(dtype);
    match check_finite("t", &Tensor::<2>::from_data(data, (&device(), dtype))) {
        Ok(()) => None,
        Err(Error::NonFinite { tensor, row, found }) => {
            assert_eq!(tensor, "t");
            Some((row, found))
        }
        Err(other) => panic!("{other}"),
    }
}

#[test]
fn the_first_bad_value_is_found_wherever_it_is() {
    let infinity = f64::INFINITY;
    for dtype in [DType::F32, DType::F64] {
        assert_eq!(first(50_000, &[], dtype), None);
        assert_eq!(first(0, &[], dtype), None);
        for at in [0, 1, 16_383, 16_384, 90_000, 149_999] {
            assert_eq!(first(50_000, &[(at, infinity)], dtype), Some((at / 3, infinity)));
            assert_eq!(first(50_000, &[(at, -infinity), (149_999, infinity)], dtype).unwrap().0, at / 3);
            let (row, found) = first(50_000, &[(at, f64::NAN)], dtype).unwrap();
            assert!(row == at / 3 && found.is_nan());
        }
    }
}

#[test]
fn the_message_names_tensor_row_and_value() {
    let data = TensorData::new(vec![1.0, f64::NAN], [2]);
    let tensor = Tensor::<1>::from_data(data, (&device(), DType::F64));
    let error = check_finite("gaussians.opacities", &tensor).unwrap_err();
    assert_eq!(error.to_string(), "tensor `gaussians.opacities` is NaN at row 1, expected a finite value");
}
