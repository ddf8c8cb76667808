use burn::tensor::{Int, Tensor};

use super::{SurfelLoss, SurfelLossWeights, surfel_loss};
use crate::ops::fixtures::{constant, layers};
use crate::testing::device;
use crate::testing::golden::values;
use crate::testing::gradients::{check, leaf};
use crate::testing::random::Random;

const WIDTH: usize = 9;
const HEIGHT: usize = 7;
const PLANE: usize = WIDTH * HEIGHT;

struct View {
    layers: usize,
    image: Vec<f64>,
    target: Vec<f64>,
    transmittance: Vec<f64>,
    ids: Vec<i32>,
    masked: bool,
}

fn is_ignored(pixel: usize) -> bool {
    pixel % 5 == 2
}

impl View {
    /// Every number of layers at some pixel.
    fn random(layers: usize, masked: bool) -> Self {
        let mut random = Random::new(layers as u64);
        let present = |pixel: usize| pixel % (layers + 1);
        let ids = (0..layers * PLANE).map(|at| if at / PLANE < present(at % PLANE) { 3 } else { -1 }).collect();
        Self {
            layers,
            image: random.numbers(3 * PLANE, -0.1, 1.1),
            target: random.numbers(3 * PLANE, 0.0, 1.0),
            transmittance: random.numbers((layers + 1) * PLANE, 0.0, 1.0),
            ids,
            masked,
        }
    }

    fn weights(&self, image: f64, transmittance: f64) -> SurfelLossWeights {
        let ignored = (0..PLANE).filter(|&pixel| self.masked && is_ignored(pixel)).count();
        let pixels_per_counted = PLANE as f64 / (PLANE - ignored) as f64;
        SurfelLossWeights { image, transmittance, pixels_per_counted }
    }

    fn leaves(&self) -> [Tensor<3>; 2] {
        let of = |values: &[f64]| leaf(values, [values.len() / PLANE, HEIGHT, WIDTH], &device());
        [of(&self.image), of(&self.transmittance)]
    }

    fn ids(&self) -> Tensor<3, Int> {
        layers(&self.ids, constant(&vec![0.0; self.ids.len()], [self.layers, HEIGHT, WIDTH])).ids
    }

    fn loss(&self, [image, transmittance]: &[Tensor<3>; 2], weights: &SurfelLossWeights) -> SurfelLoss {
        let target = constant(&self.target, [3, HEIGHT, WIDTH]);
        let ignored: Vec<f64> = (0..PLANE).map(|pixel| f64::from(u8::from(is_ignored(pixel)))).collect();
        let ignored = constant(&ignored, [1, HEIGHT, WIDTH]);
        surfel_loss(image, transmittance, &self.ids(), &target, self.masked.then_some(&ignored), weights).unwrap()
    }

    /// L_s and L_t by their formulas.
    fn plainly(&self, image: &[f64], transmittance: &[f64]) -> [f64; 2] {
        let counted: Vec<usize> = (0..PLANE).filter(|&pixel| !(self.masked && is_ignored(pixel))).collect();
        let difference = |at: usize| (image[at] - self.target[at]).abs();
        let of_image = |pixel: usize| (0..3).map(|channel| difference(channel * PLANE + pixel)).sum::<f64>() / 3.0;
        let of_transmittance = |pixel: usize| {
            let covered = self.layers >= 2 && self.ids[PLANE + pixel] >= 0;
            if covered { (1.0 - transmittance[self.layers * PLANE + pixel]).powi(2) } else { 0.0 }
        };
        let mean = |of: &dyn Fn(usize) -> f64| counted.iter().map(|&p| of(p)).sum::<f64>() / counted.len() as f64;
        [mean(&of_image), mean(&of_transmittance)]
    }
}

#[test]
fn terms_and_their_sum_are_the_formulas() {
    for (layers, masked) in [(1, false), (2, true), (3, false), (3, true), (8, true)] {
        let view = View::random(layers, masked);
        let found = view.loss(&view.leaves(), &view.weights(0.3, 0.8));
        let [image, transmittance] = view.plainly(&view.image, &view.transmittance);
        let expected = [(&found.image, image), (&found.transmittance, transmittance)];
        for (found, expected) in expected.into_iter().chain([(&found.weighted, 0.3 * image + 0.8 * transmittance)]) {
            approx::assert_relative_eq!(values(found)[0], expected, max_relative = 1e-12);
        }
    }
}

#[test]
fn gradients_are_central_differences() {
    for (layers, masked) in [(1, false), (2, true), (3, false), (3, true)] {
        let view = View::random(layers, masked);
        let leaves = view.leaves();
        let gradients = (view.loss(&leaves, &view.weights(0.3, 0.8)).weighted * -1.5).backward();
        let [image, transmittance] = leaves.each_ref().map(|leaf| values(&leaf.grad(&gradients).unwrap()));
        let loss = |[image, transmittance]: [f64; 2]| -1.5 * (0.3 * image + 0.8 * transmittance);
        check(&format!("image, K = {layers}"), &view.image, &image, 1e-5, |moved| {
            loss(view.plainly(moved, &view.transmittance))
        });
        check(&format!("transmittance, K = {layers}"), &view.transmittance, &transmittance, 1e-5, |moved| {
            loss(view.plainly(&view.image, moved))
        });
    }
}

#[test]
fn a_term_of_weight_0_is_not_part_of_the_sum() {
    let view = View::random(2, false);
    for (weights, reached) in [((0.5, 0.0), [true, false]), ((0.0, 0.5), [false, true])] {
        let leaves = view.leaves();
        let found = view.loss(&leaves, &view.weights(weights.0, weights.1));
        let [image, transmittance] = view.plainly(&view.image, &view.transmittance);
        let expected = weights.0 * image + weights.1 * transmittance;
        approx::assert_relative_eq!(values(&found.weighted)[0], expected, max_relative = 1e-12);
        let gradients = found.weighted.backward();
        assert_eq!(leaves.each_ref().map(|leaf| leaf.grad(&gradients).is_some()), reached);
    }
}

#[test]
fn tensors_that_do_not_fit_are_refused_by_name() {
    let view = View::random(2, false);
    let [image, transmittance] = view.leaves();
    let (ids, weights) = (view.ids(), view.weights(1.0, 1.0));
    let planes = image.clone().slice([0..2, 0..HEIGHT, 0..WIDTH]);
    let refused = |image: &Tensor<3>, transmittance: &Tensor<3>, target: &Tensor<3>| {
        surfel_loss(image, transmittance, &ids, target, None, &weights).unwrap_err().to_string()
    };
    assert!(refused(&planes, &transmittance, &image).contains("surfel image"));
    assert!(refused(&image, &planes, &image).contains("transmittance"));
    assert!(refused(&image, &transmittance, &planes).contains("target"));
}
