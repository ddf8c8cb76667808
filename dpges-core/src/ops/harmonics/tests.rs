use burn::tensor::Tensor;

use super::harmonics;
use crate::ops::colour::colour;
use crate::scene::{Colour, ColourModel};
use crate::testing::device;
use crate::testing::golden::values;
use crate::testing::gradients::{check, leaf};
use crate::testing::random::Random;

const CENTRE: [f64; 3] = [0.3, -0.2, 0.1];
const COUNT: usize = 6;

/// Base, detail and positions.
fn rows(coefficients: usize) -> [Vec<f64>; 3] {
    let mut random = Random::new(11);
    [
        random.numbers(COUNT, -1.0, 1.0),
        random.numbers((coefficients - 1) * COUNT, -1.2, 1.2),
        random.numbers(3 * COUNT, -2.0, 2.0),
    ]
}

fn leaves([base, detail, positions]: &[Vec<f64>; 3]) -> [Tensor<2>; 3] {
    let width = detail.len() / COUNT;
    [(base, 1), (detail, width), (positions, 3)].map(|(values, width)| leaf(values, [COUNT, width], &device()))
}

#[test]
fn values_are_those_of_a_channel_of_harmonic_colours() {
    for degree in 0..4 {
        let rows = rows((degree + 1) * (degree + 1));
        let [base, detail, positions] = leaves(&rows);
        let found = values(&harmonics(&base, &detail, &positions, CENTRE).unwrap());
        let thrice = |values: &[f64]| values.iter().flat_map(|&value| [value; 3]).collect::<Vec<f64>>();
        let model = ColourModel::SphericalHarmonics { degree };
        let colours = Colour::new(
            model,
            leaf(&thrice(&rows[0]), [COUNT, 3], &device()),
            leaf(&thrice(&rows[1]), [COUNT, model.detail_len()], &device()),
        );
        let expected = values(&colour(&colours, &positions, CENTRE).unwrap());
        for (found, expected) in found.iter().zip(expected.chunks_exact(3)) {
            approx::assert_relative_eq!(*found, expected[1] - 0.5, epsilon = 1e-14);
        }
    }
}

#[test]
fn gradients_are_central_differences_and_the_direction_carries_none() {
    for coefficients in [1, 4, 9, 16] {
        let rows = rows(coefficients);
        let weights = leaf(&Random::new(5).numbers(COUNT, -1.0, 1.0), [COUNT, 1], &device()).detach();
        let loss = |[base, detail, positions]: &[Tensor<2>; 3]| {
            (harmonics(base, detail, positions, CENTRE).unwrap() * weights.clone()).sum()
        };
        let at = leaves(&rows);
        let gradients = loss(&at).backward();
        assert!(at[2].grad(&gradients).is_none());
        for (i, name) in ["base", "detail"].into_iter().enumerate() {
            let found = at[i].grad(&gradients).map_or_else(Vec::new, |gradient| values(&gradient));
            check(&format!("{name} of {coefficients}"), &rows[i], &found, 1e-6, |moved| {
                let mut rows = rows.clone();
                rows[i] = moved.to_vec();
                values(&loss(&leaves(&rows)))[0]
            });
        }
    }
}

#[test]
fn numbers_of_coefficients_that_no_degree_has_are_refused() {
    let [base, detail, positions] = leaves(&rows(3));
    let error = harmonics(&base, &detail, &positions, CENTRE).unwrap_err().to_string();
    assert!(error.contains("`harmonics detail` has shape [6, 2], expected [6, 0], [6, 3]"), "{error}");
}
