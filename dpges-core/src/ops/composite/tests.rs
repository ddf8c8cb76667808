use burn::tensor::Tensor;

use super::{Composite, CompositeOptions, composite};
use crate::ops::fixtures::{assert_near, constant, gradient_of, layers, replaced};
use crate::ops::visibility::Visibility;
use crate::testing::device;
use crate::testing::golden::values;
use crate::testing::gradients::{check, leaf};
use crate::testing::random::Random;

const WIDTH: usize = 7;
const HEIGHT: usize = 11;
const PLANE: usize = WIDTH * HEIGHT;
const SURFELS: usize = 5;
const BACKGROUND: [f64; 3] = [0.2, 0.5, -0.1];
const OUTPUTS: [&str; 4] = ["image", "surfel image", "Gaussian colour", "Gaussian weight"];
const NAMES: [&str; 4] = ["weights", "transmittance", "colours", "sums"];

/// Weights, transmittances, colours and sums of a view, and its ids.
#[derive(Clone)]
struct Flat {
    layers: usize,
    ids: Vec<i32>,
    values: [Vec<f64>; 4],
}

/// One image per output.
type Outputs = [Vec<f64>; 4];

impl Flat {
    /// Every number of layers at some pixel.
    fn random(layers: usize, seed: u64) -> Self {
        let mut random = Random::new(seed);
        let (mut ids, mut weights) = (vec![-1; layers * PLANE], vec![0.0; layers * PLANE]);
        for at in 0..PLANE {
            for k in 0..at % (layers + 1) {
                ids[k * PLANE + at] = random.below(SURFELS) as i32;
                weights[k * PLANE + at] = random.between(0.05, 0.95);
            }
        }
        let transmittance = random.numbers((layers + 1) * PLANE, 0.0, 1.0);
        let colours = random.numbers(3 * SURFELS, -0.2, 1.2);
        let mut sums = random.numbers(4 * layers * PLANE, -0.5, 2.0);
        for k in 0..layers {
            sums[(4 * k + 3) * PLANE..][..PLANE].iter_mut().for_each(|weight| *weight = weight.max(0.0));
        }
        Self { layers, ids, values: [weights, transmittance, colours, sums] }
    }

    fn leaves(&self) -> (Visibility, Tensor<2>, Tensor<4>) {
        let device = device();
        let [weights, transmittance, colours, sums] = &self.values;
        let planes = |values: &[f64], planes: usize| leaf(values, [planes, HEIGHT, WIDTH], &device);
        let transmittance = planes(transmittance, self.layers + 1);
        let limits = transmittance.clone().detach();
        (
            Visibility { weights: planes(weights, self.layers), transmittance, limits },
            leaf(colours, [SURFELS, 3], &device),
            leaf(sums, [self.layers, 4, HEIGHT, WIDTH], &device),
        )
    }

    fn composite(&self, (seen, colours, sums): &(Visibility, Tensor<2>, Tensor<4>), detach: bool) -> Composite {
        let layers = layers(&self.ids, seen.weights.clone());
        let options = CompositeOptions { background: BACKGROUND, detach_transmittance: detach };
        composite(&layers, seen, colours, sums, &options).unwrap()
    }

    /// The outputs by their formulas; with `gates`, the Gaussians are weighted by the transmittances of that view.
    fn composite_plainly(&self, gates: Option<&Self>) -> Outputs {
        let mut out = [3, 3, 3, 1].map(|planes| vec![0.0; planes * PLANE]);
        let [weights, through, colours, sums] = &self.values;
        let gate = &gates.unwrap_or(self).values[1];
        let sum = |of: &dyn Fn(usize) -> f64| (0..self.layers).map(of).sum::<f64>();
        for at in 0..PLANE {
            let weight = sum(&|k| gate[k * PLANE + at] * sums[(4 * k + 3) * PLANE + at]);
            for c in 0..3 {
                let colour = |k: usize| usize::try_from(self.ids[k * PLANE + at]).map_or(0.0, |id| colours[3 * id + c]);
                let open = through[self.layers * PLANE + at] * BACKGROUND[c];
                let surfels = sum(&|k| weights[k * PLANE + at] * colour(k)) + open;
                let gaussians = sum(&|k| gate[k * PLANE + at] * sums[(4 * k + c) * PLANE + at]);
                out[0][c * PLANE + at] = (surfels + gaussians) / (1.0 + weight);
                out[1][c * PLANE + at] = surfels;
                out[2][c * PLANE + at] = gaussians;
            }
            out[3][at] = weight;
        }
        out
    }
}

fn outputs(of: &Composite) -> [&Tensor<3>; 4] {
    [&of.image, &of.surfel_image, &of.gaussian_colour, &of.gaussian_weight]
}

/// Compares the gradients of a weighted sum of some outputs with central differences of the formulas.
fn check_gradients(flat: &Flat, kinds: &[usize], detach: bool, seed: u64) {
    let leaves = flat.leaves();
    let rendered = flat.composite(&leaves, detach);
    let mut random = Random::new(seed);
    let images: Vec<&Tensor<3>> = kinds.iter().map(|&kind| outputs(&rendered)[kind]).collect();
    let weights: Vec<Vec<f64>> =
        images.iter().map(|image| random.numbers(image.dims().iter().product(), -1.0, 1.0)).collect();
    let losses =
        images.iter().zip(&weights).map(|(image, weights)| ((*image).clone() * constant(weights, image.dims())).sum());
    let gradients = losses.reduce(|sum, loss| sum + loss).unwrap().backward();
    let (seen, colours, sums) = &leaves;
    let found = [
        gradient_of(&seen.weights, &gradients),
        gradient_of(&seen.transmittance, &gradients),
        gradient_of(colours, &gradients),
        gradient_of(sums, &gradients),
    ];
    for (i, found) in found.into_iter().enumerate() {
        let of: Vec<&str> = kinds.iter().map(|&kind| OUTPUTS[kind]).collect();
        let name = format!("{of:?} (K = {}, detach {detach}) with respect to {}", flat.layers, NAMES[i]);
        // a layer that is missing has no weight that could be moved
        let present = |at: usize| i != 0 || flat.ids[at] >= 0;
        check(&name, &flat.values[i], &found, 1e-4, |moved| {
            let kept = moved.iter().enumerate().map(|(at, value)| if present(at) { *value } else { 0.0 });
            let moved = Flat { values: replaced(&flat.values, i, &kept.collect::<Vec<_>>()), ..flat.clone() };
            let out = moved.composite_plainly(detach.then_some(flat));
            let weighted = |(&kind, weights): (&usize, &Vec<f64>)| -> f64 {
                out[kind].iter().zip(weights).map(|(a, b)| a * b).sum()
            };
            kinds.iter().zip(&weights).map(weighted).sum()
        });
    }
}

#[test]
fn outputs_are_the_formulas() {
    for layers in 1..=8 {
        let flat = Flat::random(layers, layers as u64);
        let (found, expected) = (flat.composite(&flat.leaves(), false), flat.composite_plainly(None));
        for (found, expected) in outputs(&found).into_iter().zip(expected) {
            assert_near(&values(found), &expected, 1e-12);
        }
    }
}

#[test]
fn gradients_of_every_output_are_central_differences() {
    for layers in 1..=4 {
        let flat = Flat::random(layers, 10 + layers as u64);
        for (kind, detach) in (0..OUTPUTS.len()).flat_map(|kind| [(kind, false), (kind, true)]) {
            check_gradients(&flat, &[kind], detach, 3);
        }
    }
}

#[test]
fn a_loss_of_all_outputs_goes_back_from_all_of_them() {
    for detach in [false, true] {
        check_gradients(&Flat::random(3, 20), &[0, 1, 2, 3], detach, 4);
    }
}

#[test]
fn gaussians_behind_an_opaque_first_layer_change_neither_image_nor_gradient() {
    let mut flat = Flat::random(3, 1);
    flat.values[1][PLANE..].fill(0.0);
    let mut without = flat.clone();
    without.values[3][4 * PLANE..].fill(0.0);
    let leaves = flat.leaves();
    let image = flat.composite(&leaves, false).image;
    assert_eq!(values(&image), values(&without.composite(&without.leaves(), false).image));
    let sums = values(&leaves.2.grad(&image.sum().backward()).unwrap());
    assert!(sums[4 * PLANE..].iter().all(|g| *g == 0.0) && sums[..4 * PLANE].iter().any(|g| *g != 0.0));
}
