use super::harmonics;
use crate::ops::colour::colour;
use crate::ops::fixtures::{check_rows, constant, leaves_of, weights};
use crate::scene::{Colour, ColourModel};
use crate::testing::golden::values;
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

fn widths(rows: &[Vec<f64>; 3]) -> [usize; 3] {
    [1, rows[1].len() / COUNT, 3]
}

#[test]
fn values_are_those_of_a_channel_of_harmonic_colours() {
    for degree in 0..4 {
        let rows = rows((degree + 1) * (degree + 1));
        let [base, detail, positions] = leaves_of(&rows, widths(&rows), COUNT);
        let found = values(&harmonics(&base, &detail, &positions, CENTRE).unwrap());
        let thrice = |values: &[f64]| values.iter().flat_map(|&value| [value; 3]).collect::<Vec<f64>>();
        let model = ColourModel::SphericalHarmonics { degree };
        let colours = Colour::new(
            model,
            constant(&thrice(&rows[0]), [COUNT, 3]),
            constant(&thrice(&rows[1]), [COUNT, model.detail_len()]),
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
        let [base, detail, positions] = rows(coefficients);
        let weights = weights(5, [COUNT, 1]);
        let at = constant(&positions, [COUNT, 3]).require_grad();
        let rows = [base, detail];
        check_rows(
            &coefficients.to_string(),
            ["base", "detail"],
            &rows,
            [1, coefficients - 1],
            1e-6,
            |[base, detail]| (harmonics(base, detail, &at, CENTRE).unwrap() * weights.clone()).sum(),
        );
        let [base, detail] = leaves_of(&rows, [1, coefficients - 1], COUNT);
        let gradients = harmonics(&base, &detail, &at, CENTRE).unwrap().sum().backward();
        assert!(at.grad(&gradients).is_none());
    }
}

#[test]
fn numbers_of_coefficients_that_no_degree_has_are_refused() {
    let rows = rows(3);
    let [base, detail, positions] = leaves_of(&rows, widths(&rows), COUNT);
    let error = harmonics(&base, &detail, &positions, CENTRE).unwrap_err().to_string();
    assert!(error.contains("`harmonics detail` has shape [6, 2], expected [6, 0], [6, 3]"), "{error}");
}
