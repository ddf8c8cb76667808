use burn::tensor::{DType, Device, Tensor, TensorData};

use super::{AdamParameter, AdamState, AdamStep, adam_step};
use crate::error::Error;
use crate::testing::device;
use crate::testing::golden::values;
use crate::testing::random::Random;

fn tensor<const D: usize>(values: &[f64], shape: [usize; D], dtype: DType, device: &Device) -> Tensor<D> {
    Tensor::from_data(TensorData::new(values.to_vec(), shape).convert_dtype(dtype), (device, dtype))
}

fn gate(open: f64, dtype: DType, device: &Device) -> Tensor<1> {
    tensor(&[open], [1], dtype, device)
}

fn step(time: u64) -> AdamStep {
    AdamStep { beta_1: 0.9, beta_2: 0.999, epsilon: 1e-15, time }
}

/// Numbers of a parameter in host memory, and where they go.
#[derive(Clone)]
struct Numbers {
    shape: [usize; 2],
    value: Vec<f64>,
    moments: [Vec<f64>; 2],
}

impl Numbers {
    fn fresh(shape: [usize; 2], value: Vec<f64>) -> Self {
        let zeros = vec![0.0; value.len()];
        Self { shape, moments: [zeros.clone(), zeros], value }
    }

    fn state(&self, dtype: DType, device: &Device) -> AdamState {
        let [rows, width] = self.shape;
        let value = tensor(&self.value, self.shape, dtype, device);
        AdamState { value, moments: tensor(&self.moments.concat(), [2, rows, width], dtype, device) }
    }

    fn step(&mut self, gradient: &[f64], learning_rate: f64, time: u64) {
        let (correct_1, correct_2) = (1.0 - 0.9f64.powi(time as i32), 1.0 - 0.999f64.powi(time as i32));
        let [m, v] = &mut self.moments;
        for i in 0..gradient.len() {
            m[i] = 0.9 * m[i] + 0.1 * gradient[i];
            v[i] = 0.999 * v[i] + 0.001 * gradient[i] * gradient[i];
            self.value[i] -= learning_rate * (m[i] / correct_1) / ((v[i] / correct_2).sqrt() + 1e-15);
        }
    }

    fn assert_close(&self, found: &AdamState, tolerance: f64) {
        let [rows, width] = self.shape;
        assert_eq!((found.value.dims(), found.moments.dims()), (self.shape, [2, rows, width]));
        let expected = [self.value.clone(), self.moments.concat()];
        for (found, expected) in [values(&found.value), values(&found.moments)].iter().zip(&expected) {
            assert_eq!(found.len(), expected.len());
            let apart = found.iter().zip(expected).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
            assert!(apart < tolerance, "{rows} × {width} off by {apart:e}");
        }
    }
}

fn parameter(state: AdamState, gradient: &[f64]) -> AdamParameter<'static> {
    let (shape, dtype, device) = (state.value.dims(), state.value.dtype(), state.value.device());
    AdamParameter { name: "numbers", state, gradient: tensor(gradient, shape, dtype, &device), learning_rate: 0.1 }
}

/// A parameter alone after one step.
fn alone(state: AdamState, gradient: &[f64], open: f64, time: u64) -> AdamState {
    let gate = gate(open, state.value.dtype(), &state.value.device());
    adam_step(vec![parameter(state, gradient)], &gate, &step(time)).unwrap().pop().unwrap()
}

#[test]
fn two_steps_by_hand() {
    let device = device().inner();
    let start = Numbers::fresh([1, 2], vec![1.0, -2.0]).state(DType::F64, &device);
    let state = alone(start, &[3.0, -0.5], 1.0, 1);
    // the first step is lr · sign(g) whatever the size of g
    for (found, expected) in values(&state.value).iter().zip([0.9, -1.9]) {
        approx::assert_relative_eq!(*found, expected, epsilon = 1e-12);
    }
    let state = alone(state, &[1.0, 0.0], 1.0, 2);
    // m = 0.9 · 0.3 + 0.1 · 1 = 0.37, v = 0.999 · 0.009 + 0.001 · 1 = 0.009991; m̂ = m / 0.19, v̂ = v / 0.001999
    // m = 0.9 · −0.05 = −0.045, v = 0.999 · 0.00025 = 0.00024975
    let expected = [
        0.37,
        -0.045,
        0.009_991,
        0.000_249_75,
        0.9 - 0.1 * 1.947_368_421 / 2.235_620_495,
        -1.9 + 0.1 * 0.236_842_105 / 0.353_464_947,
    ];
    for (found, expected) in [values(&state.moments), values(&state.value)].concat().iter().zip(expected) {
        approx::assert_relative_eq!(*found, expected, epsilon = 1e-9);
    }
}

/// Even and odd numbers of parameters, and some without numbers, at rates of their own.
#[test]
fn many_steps_of_several_parameters_follow_the_formula() {
    let device = device().inner();
    let shapes = [[10_000, 4], [3, 1], [0, 3], [5_000, 2], [7, 0], [1, 3], [400, 45]];
    for (dtype, tolerance) in [(DType::F64, 1e-12), (DType::F32, 1e-5)] {
        for count in 1..=shapes.len() {
            let mut random = Random::new(count as u64);
            let fresh = |shape: [usize; 2], random: &mut Random| {
                Numbers::fresh(shape, random.numbers(shape[0] * shape[1], -1.0, 1.0))
            };
            let mut expected: Vec<Numbers> = shapes[..count].iter().map(|&shape| fresh(shape, &mut random)).collect();
            let mut states: Vec<AdamState> = expected.iter().map(|numbers| numbers.state(dtype, &device)).collect();
            for time in 1..=3 {
                let mut parameters = Vec::new();
                for (at, (state, expected)) in states.into_iter().zip(&mut expected).enumerate() {
                    let gradient = random.numbers(expected.value.len(), -1.0, 1.0);
                    let gradient: Vec<f64> = gradient.iter().map(|g| g.powi(5)).collect();
                    let learning_rate = 0.1 / (1.0 + at as f64);
                    expected.step(&gradient, learning_rate, time);
                    parameters.push(AdamParameter { learning_rate, ..parameter(state, &gradient) });
                }
                states = adam_step(parameters, &gate(1.0, dtype, &device), &step(time)).unwrap();
            }
            assert_eq!(states.len(), count);
            expected.iter().zip(&states).for_each(|(expected, found)| expected.assert_close(found, tolerance));
        }
    }
    assert!(adam_step(Vec::new(), &gate(1.0, DType::F32, &device), &step(1)).unwrap().is_empty());
}

#[test]
fn what_is_stepped_together_is_stepped_as_alone_to_the_bit() {
    let device = device().inner();
    for dtype in [DType::F32, DType::F64] {
        let numbers = |seed, shape: [usize; 2]| {
            let count = shape[0] * shape[1];
            let mut random = Random::new(seed);
            let moments = [random.numbers(count, -1.0, 1.0), random.numbers(count, 0.0, 1.0)];
            (Numbers { shape, value: random.numbers(count, -1.0, 1.0), moments }, random.numbers(count, -1.0, 1.0))
        };
        let all = [numbers(1, [300, 3]), numbers(2, [70, 45]), numbers(3, [9, 1])];
        let parameters = all.iter().map(|(numbers, gradient)| parameter(numbers.state(dtype, &device), gradient));
        let together = adam_step(parameters.collect(), &gate(1.0, dtype, &device), &step(4)).unwrap();
        for ((numbers, gradient), found) in all.iter().zip(together) {
            let expected = alone(numbers.state(dtype, &device), gradient, 1.0, 4);
            assert!(values(&found.value) == values(&expected.value));
            assert!(values(&found.moments) == values(&expected.moments));
        }
    }
}

#[test]
fn a_step_leaves_shared_tensors_alone_and_stands_still_without_a_gradient() {
    let device = device().inner();
    let (first, second) = (Numbers::fresh([1, 2], vec![1.0, 2.0]), Numbers::fresh([2, 1], vec![3.0, 4.0]));
    let before = [first, second].map(|numbers| numbers.state(DType::F32, &device));
    let parameters = before.each_ref().map(|state| parameter(state.clone(), &[1.0, 0.0]));
    let after = adam_step(parameters.into(), &gate(1.0, DType::F32, &device), &step(1)).unwrap();
    for (at, (before, after)) in before.iter().zip(&after).enumerate() {
        let expected = [1.0 + 2.0 * at as f64, 2.0 + 2.0 * at as f64];
        assert_eq!(values(&before.value), expected);
        assert_eq!(values(&before.moments), [0.0; 4]);
        assert!(values(&after.value)[0] < expected[0]);
        assert_eq!(values(&after.value)[1], expected[1]);
    }
}

#[test]
fn what_has_another_shape_is_refused_by_name() {
    let device = device().inner();
    let state = |shape: [usize; 2]| Numbers::fresh(shape, vec![1.0; shape[0] * shape[1]]).state(DType::F32, &device);
    let of = |name, state: AdamState, shape: [usize; 2]| AdamParameter {
        name,
        state,
        gradient: tensor(&vec![1.0; shape[0] * shape[1]], shape, DType::F32, &device),
        learning_rate: 0.1,
    };
    let open = gate(1.0, DType::F32, &device);
    let good = || of("positions", state([2, 3]), [2, 3]);
    let refused = |parameters, gate: &Tensor<1>| match adam_step(parameters, gate, &step(1)) {
        Err(Error::Shape { tensor, .. }) => tensor,
        other => panic!("{other:?}"),
    };
    assert_eq!(refused(vec![good(), of("opacities", state([2, 1]), [3, 1])], &open), "gradient of opacities");
    let moments = state([3, 1]).moments;
    let mixed = AdamState { moments, ..state([2, 1]) };
    assert_eq!(refused(vec![of("opacities", mixed, [2, 1]), good()], &open), "moments of opacities");
    assert_eq!(refused(vec![good()], &tensor(&[1.0, 1.0], [2], DType::F32, &device)), "gate");
}

#[test]
fn a_closed_gate_holds_everything_back() {
    let device = device().inner();
    for dtype in [DType::F32, DType::F64] {
        let numbers = Numbers { shape: [1, 2], value: vec![1.0, 2.0], moments: [vec![0.5, 0.25], vec![0.125, 1.0]] };
        for count in [1, 2, 3] {
            let bad = [f64::NAN, 3.0];
            let parameters = (0..count).map(|_| parameter(numbers.state(dtype, &device), &bad)).collect();
            let after = adam_step(parameters, &gate(0.0, dtype, &device), &step(3)).unwrap();
            assert_eq!(after.len(), count);
            for state in after {
                assert_eq!(values(&state.value), [1.0, 2.0]);
                assert_eq!(values(&state.moments), [0.5, 0.25, 0.125, 1.0]);
            }
        }
    }
}
