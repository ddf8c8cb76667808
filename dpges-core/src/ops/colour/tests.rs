use burn::tensor::Tensor;

use super::colour;
use super::cpu::model::{base, lobe, lobe_backward};
use crate::ops::fixtures::{assert_near, check_rows, leaves_of, weights};
use crate::scene::{Colour, ColourModel, SH_C0};
use crate::testing::golden::values;
use crate::testing::random::Random;

#[test]
fn a_lobe_facing_away_adds_nothing_and_a_raw_colour_of_zero_means_a_tenth() {
    let raw = [0.0f64, 0.0, 0.0, 0.0, 0.0, 0.3];
    assert_eq!(lobe(raw, [0.0, 0.0, -1.0]), [0.0; 3]);
    for channel in lobe(raw, [0.0, 0.0, 1.0]) {
        approx::assert_relative_eq!(channel, 0.1, epsilon = 1e-15);
    }
    assert_eq!(base([0.0f64; 3]), [0.5; 3]);
}

#[test]
fn lobes_stay_finite_at_the_extremes() {
    for beta in [-80.0f32, -5.0, 5.0, 80.0, 200.0] {
        for d in [[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.6, 0.0, 0.8], [1e-30, 0.0, 1.0], [1.0, 0.0, 1e-30]] {
            let raw = [50.0, -50.0, 0.0, 0.0, 0.0, beta];
            let grad = lobe_backward(raw, d, [1.0; 3]);
            assert!(lobe(raw, d).iter().chain(&grad).all(|v| v.is_finite()), "beta {beta}, direction {d:?}: {grad:?}");
        }
    }
}

const CENTRE: [f64; 3] = [0.3, -0.2, 0.1];

/// Base, detail and positions of `count` primitives.
fn primitives(model: ColourModel, count: usize, seed: u64) -> [Vec<f64>; 3] {
    let mut random = Random::new(seed);
    [
        random.numbers(3 * count, -1.0, 1.0),
        random.numbers(model.detail_len() * count, -1.2, 1.2),
        random.numbers(3 * count, -2.0, 2.0),
    ]
}

struct Leaves {
    colour: Colour,
    positions: Tensor<2>,
}

fn leaves(model: ColourModel, rows: &[Vec<f64>; 3]) -> Leaves {
    let [base, detail, positions] = leaves_of(rows, [3, model.detail_len(), 3], rows[0].len() / 3);
    Leaves { colour: Colour::new(model, base, detail), positions }
}

#[test]
fn gradients_are_central_differences_and_the_direction_carries_none() {
    let betas = [1, 2, 3].map(|lobes| ColourModel::SphericalBeta { lobes });
    let harmonics = [0, 1, 2, 3].map(|degree| ColourModel::SphericalHarmonics { degree });
    for model in betas.into_iter().chain(harmonics) {
        let count = 6;
        let rows = primitives(model, count, 4);
        let weights = weights(5, [count, 3]);
        let Leaves { positions, .. } = leaves(model, &rows);
        let [base, detail, _] = rows;
        let widths = [3, model.detail_len()];
        let rows = [base, detail];
        let loss = |[base, detail]: &[Tensor<2>; 2]| {
            let of = Colour::new(model, base.clone(), detail.clone());
            (colour(&of, &positions, CENTRE).unwrap() * weights.clone()).sum()
        };
        check_rows(&model.to_string(), ["base", "detail"], &rows, widths, 1e-5, loss);
        let gradients = loss(&leaves_of(&rows, widths, count)).backward();
        assert!(positions.grad(&gradients).is_none_or(|g| values(&g).iter().all(|g| *g == 0.0)));
    }
}

#[test]
fn a_detail_in_parts_is_the_same_colour() {
    let parts: [(&str, &[usize]); 3] = [("sh3", &[24, 21]), ("sh2", &[6, 12, 6]), ("sb3", &[6, 12])];
    for (model, widths) in parts {
        let (model, count): (ColourModel, _) = (model.parse().unwrap(), 4);
        let rows = primitives(model, count, 8);
        let weights = weights(9, [count, 3]);
        let whole = leaves(model, &rows);
        let mut split = leaves(model, &rows);
        let mut first = 0;
        let mut columns = widths.iter().map(|&width| {
            first += width;
            whole.colour.detail.clone().inner().slice([0..count, first - width..first]).autodiff().require_grad()
        });
        split.colour.detail = columns.next().unwrap();
        split.colour.rest = columns.collect();
        let [expected, found] = [&whole, &split].map(|of| colour(&of.colour, &of.positions, CENTRE).unwrap());
        // on a CPU the sums of the parts are formed one by one
        let near = |found: &Tensor<2>, expected: &Tensor<2>| assert_near(&values(found), &values(expected), 1e-14);
        near(&found, &expected);
        let [of_whole, of_split] = [expected, found].map(|out| (out * weights.clone()).sum().backward());
        let expected = whole.colour.detail.grad(&of_whole).unwrap();
        let found = split.colour.details().map(|part| part.grad(&of_split).unwrap()).collect();
        near(&Tensor::cat(found, 1), &expected);
        let [expected, found] =
            [(&whole, &of_whole), (&split, &of_split)].map(|(of, gradients)| of.colour.base.grad(gradients).unwrap());
        near(&found, &expected);
        split.colour.rest.pop();
        let error = colour(&split.colour, &split.positions, CENTRE).unwrap_err().to_string();
        assert!(error.contains("colour.detail"), "{error}");
    }
}

#[test]
fn without_detail_both_models_are_the_base_colour() {
    let models = [ColourModel::SphericalHarmonics { degree: 0 }, ColourModel::SphericalBeta { lobes: 0 }];
    for model in models {
        let rows = primitives(model, 5, 6);
        let of = leaves(model, &rows);
        let found = values(&colour(&of.colour, &of.positions, CENTRE).unwrap());
        assert_near(&found, &rows[0].iter().map(|k| 0.5 + SH_C0 * k).collect::<Vec<f64>>(), 1e-15);
    }
}

#[test]
fn a_primitive_at_the_camera_has_a_finite_colour() {
    for model in [ColourModel::SphericalHarmonics { degree: 3 }, ColourModel::SphericalBeta { lobes: 2 }] {
        let mut rows = primitives(model, 1, 7);
        rows[2] = CENTRE.to_vec();
        let of = leaves(model, &rows);
        let out = colour(&of.colour, &of.positions, CENTRE).unwrap();
        let gradients = out.clone().sum().backward();
        let detail = values(&of.colour.detail.grad(&gradients).unwrap());
        assert!(values(&out).iter().chain(&detail).all(|v| v.is_finite()), "{model}: {detail:?}");
    }
}
