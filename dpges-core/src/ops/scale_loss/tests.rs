use burn::tensor::Tensor;

use super::{LINEAR_FROM, scale_loss};
use crate::testing::device;
use crate::testing::golden::values;
use crate::testing::gradients::{check_elements, leaf};
use crate::testing::random::Random;

fn tensor(log_scales: &[f64]) -> Tensor<2> {
    leaf(log_scales, [log_scales.len() / 2, 2], &device())
}

fn mean_scale(log_scales: &[f64]) -> f64 {
    log_scales.iter().map(|s| s.exp()).sum::<f64>() / log_scales.len() as f64
}

fn plainly(log_scales: &[f64], mean: f64) -> f64 {
    let of_surfel = |scales: &[f64]| {
        let x = (scales[0].exp() + scales[1].exp()) / (2.0 * mean);
        if x < LINEAR_FROM { x.exp() } else { LINEAR_FROM.exp() * (x - LINEAR_FROM + 1.0) }
    };
    log_scales.chunks(2).map(of_surfel).sum::<f64>() / (log_scales.len() / 2) as f64
}

#[test]
fn the_value_is_the_formula_for_any_number_of_surfels() {
    for count in [1, 2, 127, 4_096, 20_001] {
        let log_scales = Random::new(count as u64).numbers(2 * count, -3.0, 0.5);
        let found = scale_loss(&tensor(&log_scales), 0.25);
        let expected = plainly(&log_scales, mean_scale(&log_scales));
        approx::assert_relative_eq!(values(&found.value)[0], expected, max_relative = 1e-12);
        approx::assert_relative_eq!(values(&found.weighted)[0], 0.25 * expected, max_relative = 1e-12);
    }
}

#[test]
fn the_gradient_is_central_differences_about_a_fixed_mean() {
    let log_scales = Random::new(3).numbers(2 * 5_000, -2.0, 0.0);
    let mean = mean_scale(&log_scales);
    let leaf = tensor(&log_scales);
    let gradients = (scale_loss(&leaf, 0.5).weighted * 3.0).backward();
    let gradient = values(&leaf.grad(&gradients).unwrap());
    let elements: Vec<usize> = (0..gradient.len()).step_by(101).collect();
    // of the surfel that moves alone, since the others drown what it changes
    let count = (log_scales.len() / 2) as f64;
    for element in elements {
        let surfel = element / 2 * 2;
        let own = &log_scales[surfel..surfel + 2];
        check_elements("scale loss", own, &gradient[surfel..surfel + 2], &[element % 2], 1e-5, |moved| {
            1.5 * plainly(moved, mean) / count
        });
    }
}

#[test]
fn nothing_is_lost_without_surfels() {
    let found = scale_loss(&tensor(&[]), 1.0);
    assert_eq!((values(&found.value), values(&found.weighted)), (vec![0.0], vec![0.0]));
}
