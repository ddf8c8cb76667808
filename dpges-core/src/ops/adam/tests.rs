use burn::tensor::{DType, Tensor};

use super::{AdamStep, adam_step};
use crate::ops::fixtures::of_type;
use crate::testing::device;
use crate::testing::golden::values;
use crate::testing::random::Random;

fn tensor(values: &[f64], dtype: DType) -> Tensor<1> {
    of_type(values, [values.len()], &device().inner(), dtype)
}

fn step(time: u64) -> AdamStep {
    AdamStep { learning_rate: 0.1, beta_1: 0.9, beta_2: 0.999, epsilon: 1e-15, time }
}

#[test]
fn many_steps_follow_the_formula() {
    for (dtype, tolerance) in [(DType::F64, 1e-12), (DType::F32, 1e-5)] {
        let count = 40_000;
        let mut random = Random::new(1);
        let mut p = random.numbers(count, -1.0, 1.0);
        let (mut m, mut v) = (vec![0.0; count], vec![0.0; count]);
        let of = |values: &[f64]| tensor(values, dtype);
        let (mut parameter, mut moments) = (of(&p), [of(&m), of(&v)]);
        for time in 1..=5 {
            let grad: Vec<f64> = random.numbers(count, -1.0, 1.0).iter().map(|g| g.powi(5)).collect();
            (parameter, moments) = adam_step(parameter, moments, &of(&grad), &of(&[1.0]), &step(time)).unwrap();
            let (correct_1, correct_2) = (1.0 - 0.9f64.powi(time as i32), 1.0 - 0.999f64.powi(time as i32));
            for i in 0..count {
                m[i] = 0.9 * m[i] + 0.1 * grad[i];
                v[i] = 0.999 * v[i] + 0.001 * grad[i] * grad[i];
                p[i] -= 0.1 * (m[i] / correct_1) / ((v[i] / correct_2).sqrt() + 1e-15);
            }
        }
        for (found, expected) in [(&parameter, &p), (&moments[0], &m), (&moments[1], &v)] {
            let found = values(found);
            let apart = found.iter().zip(expected).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
            assert!(apart < tolerance, "{dtype:?}: off by {apart:e}");
        }
    }
}

#[test]
fn a_step_leaves_shared_tensors_alone_and_stands_still_without_a_gradient() {
    let of = |values: &[f64]| tensor(values, DType::F32);
    let (before, zero) = (of(&[1.0, 2.0]), of(&[0.0, 0.0]));
    let (after, _) =
        adam_step(before.clone(), [zero.clone(), zero.clone()], &of(&[1.0, 0.0]), &of(&[1.0]), &step(1)).unwrap();
    assert_eq!(values(&before), [1.0, 2.0]);
    assert_eq!(values(&zero), [0.0, 0.0]);
    assert_eq!(values(&after)[1], 2.0);
    assert!(adam_step(before, [zero.clone(), zero], &of(&[1.0]), &of(&[1.0]), &step(1)).is_err());
}

#[test]
fn a_closed_gate_holds_everything_back() {
    for dtype in [DType::F32, DType::F64] {
        let of = |values: &[f64]| tensor(values, dtype);
        let moments = [of(&[0.5, 0.25]), of(&[0.125, 1.0])];
        let grad = of(&[f64::NAN, 3.0]);
        let (parameter, [m, v]) = adam_step(of(&[1.0, 2.0]), moments, &grad, &of(&[0.0]), &step(3)).unwrap();
        assert_eq!(values(&parameter), [1.0, 2.0]);
        assert_eq!(values(&m), [0.5, 0.25]);
        assert_eq!(values(&v), [0.125, 1.0]);
    }
}
