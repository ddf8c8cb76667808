use burn::tensor::{DType, Tensor};

use super::{FiniteChecks, check_finite};
use crate::error::Error;
use crate::ops::fixtures::of_type;
use crate::testing::device;
use crate::testing::golden::values;

fn rows(count: usize, bad: &[(usize, f64)], dtype: DType) -> Tensor<2> {
    let mut values: Vec<f64> = (0..count * 3).map(|i| f64::from(i as f32).sin() * 1e30).collect();
    bad.iter().for_each(|&(at, value)| values[at] = value);
    of_type(&values, [count, 3], &device(), dtype)
}

fn first(tensor: &Tensor<2>) -> Option<usize> {
    let mut checks = FiniteChecks::default();
    checks.add("t", tensor);
    match check_finite(checks) {
        Ok(()) => None,
        Err(Error::NonFinite { tensor, row }) => {
            assert_eq!(tensor, "t");
            Some(row)
        }
        Err(other) => panic!("{other}"),
    }
}

#[test]
fn the_first_bad_value_is_found_wherever_it_is() {
    let infinity = f64::INFINITY;
    for dtype in [DType::F32, DType::F64] {
        assert_eq!(first(&rows(50_000, &[], dtype)), None);
        assert_eq!(first(&rows(0, &[], dtype)), None);
        for at in [0, 1, 16_383, 16_384, 90_000, 149_999] {
            for value in [infinity, -infinity, f64::NAN] {
                assert_eq!(first(&rows(50_000, &[(at, value)], dtype)), Some(at / 3));
            }
            assert_eq!(first(&rows(50_000, &[(at, -infinity), (149_999, infinity)], dtype)), Some(at / 3));
        }
    }
}

#[test]
fn of_several_tensors_the_bad_one_is_named_with_its_row() {
    assert!(check_finite(FiniteChecks::default()).is_ok());
    let mut checks = FiniteChecks::default();
    checks.add("surfels.positions", &rows(2, &[], DType::F64));
    checks.add("gaussians.opacities", &rows(4, &[(10, f64::NAN)], DType::F64));
    let found = checks.launch();
    let error = found.check().unwrap_err();
    assert_eq!(error.to_string(), "tensor `gaussians.opacities` is not finite at row 3, expected finite numbers");
    assert_eq!(found.positions().into_data().iter::<i64>().collect::<Vec<_>>(), [-1, 10]);
}

/// Around the number of tensors of a launch.
#[test]
fn a_gate_is_open_if_every_tensor_is_finite() {
    for count in [1, 5, 6, 7, 12, 13] {
        for bad in [vec![], vec![0], vec![count - 1], (0..count).collect::<Vec<_>>()] {
            let mut checks = FiniteChecks::default();
            for tensor in 0..count {
                let marks: &[(usize, f64)] = if bad.contains(&tensor) { &[(4, f64::INFINITY)] } else { &[] };
                checks.add(format!("{tensor}"), &rows(2 + tensor, marks, DType::F32));
            }
            let found = checks.launch();
            let expected: Vec<i64> = (0..count).map(|tensor| if bad.contains(&tensor) { 4 } else { -1 }).collect();
            assert_eq!(found.positions().into_data().iter::<i64>().collect::<Vec<_>>(), expected);
            let gate = found.gate();
            let open = if bad.is_empty() { 1.0 } else { 0.0 };
            assert_eq!((values(&gate.open), values(&gate.bad)), (vec![open], vec![bad.len() as f64]));
        }
    }
}
