use burn::tensor::Tensor;

use super::{Composite, CompositeOptions, OutputKind, composite};
use crate::ops::fixtures::{assert_near, constant, gradient_of, layers, replaced};
use crate::testing::device;
use crate::testing::golden::values;
use crate::testing::gradients::{check, leaf};
use crate::testing::random::Random;

const WIDTH: usize = 7;
const HEIGHT: usize = 11;
const PLANE: usize = WIDTH * HEIGHT;
const SURFELS: usize = 5;
const BACKGROUND: [f64; 3] = [0.2, 0.5, -0.1];
const KINDS: [OutputKind; 5] = [
    OutputKind::Image,
    OutputKind::SurfelImage,
    OutputKind::Transmittance,
    OutputKind::GaussianColour,
    OutputKind::GaussianWeight,
];
const NAMES: [&str; 3] = ["alpha", "colours", "sums"];

/// Alpha, colours and sums of a view, and its ids.
#[derive(Clone)]
struct Flat {
    layers: usize,
    ids: Vec<i32>,
    values: [Vec<f64>; 3],
}

/// One image per [`OutputKind`].
type Outputs = [Vec<f64>; 5];

impl Flat {
    /// Every number of layers at some pixel; a third of the pixels end with an opaque one.
    fn random(layers: usize, seed: u64) -> Self {
        let mut random = Random::new(seed);
        let (mut ids, mut alpha) = (vec![-1; layers * PLANE], vec![0.0; layers * PLANE]);
        for at in 0..PLANE {
            let present = at % (layers + 1);
            for k in 0..present {
                ids[k * PLANE + at] = random.below(SURFELS) as i32;
                let opaque = k + 1 == present && at % 3 == 0;
                alpha[k * PLANE + at] = if opaque { 1.0 } else { random.between(0.05, 0.95) };
            }
        }
        let colours = random.numbers(3 * SURFELS, -0.2, 1.2);
        let mut sums = random.numbers(4 * layers * PLANE, -0.5, 2.0);
        for k in 0..layers {
            sums[(4 * k + 3) * PLANE..][..PLANE].iter_mut().for_each(|weight| *weight = weight.max(0.0));
        }
        Self { layers, ids, values: [alpha, colours, sums] }
    }

    fn leaves(&self) -> (Tensor<3>, Tensor<2>, Tensor<4>) {
        let device = device();
        let [alpha, colours, sums] = &self.values;
        (
            leaf(alpha, [self.layers, HEIGHT, WIDTH], &device),
            leaf(colours, [SURFELS, 3], &device),
            leaf(sums, [self.layers, 4, HEIGHT, WIDTH], &device),
        )
    }

    fn composite(&self, (alpha, colours, sums): &(Tensor<3>, Tensor<2>, Tensor<4>), detach: bool) -> Composite {
        let layers = layers(&self.ids, alpha.clone());
        let options = CompositeOptions { background: BACKGROUND, detach_transmittance: detach };
        composite(&layers, colours, sums, &options).unwrap()
    }

    fn transmittance(&self, at: usize) -> Vec<f64> {
        let through = |before: &mut f64, k: usize| {
            *before *= 1.0 - self.values[0][k * PLANE + at];
            Some(*before)
        };
        std::iter::once(1.0).chain((0..self.layers).scan(1.0, through)).collect()
    }

    /// The outputs by their formulas; with `gates`, the Gaussians are weighted by the transmittances of that view.
    fn composite_plainly(&self, gates: Option<&Self>) -> Outputs {
        let mut out = [3, 3, self.layers + 1, 3, 1].map(|planes| vec![0.0; planes * PLANE]);
        let [alpha, colours, sums] = &self.values;
        for at in 0..PLANE {
            let through = self.transmittance(at);
            let gate = gates.unwrap_or(self).transmittance(at);
            let weight: f64 = (0..self.layers).map(|k| gate[k] * sums[(4 * k + 3) * PLANE + at]).sum();
            for c in 0..3 {
                let surfel = |k: usize| usize::try_from(self.ids[k * PLANE + at]).map_or(0.0, |id| colours[3 * id + c]);
                let surfels: f64 = (0..self.layers).map(|k| alpha[k * PLANE + at] * through[k] * surfel(k)).sum();
                let surfels = surfels + through[self.layers] * BACKGROUND[c];
                let gaussians: f64 = (0..self.layers).map(|k| gate[k] * sums[(4 * k + c) * PLANE + at]).sum();
                out[0][c * PLANE + at] = (surfels + gaussians) / (1.0 + weight);
                out[1][c * PLANE + at] = surfels;
                out[3][c * PLANE + at] = gaussians;
            }
            through.iter().enumerate().for_each(|(k, t)| out[2][k * PLANE + at] = *t);
            out[4][at] = weight;
        }
        out
    }
}

fn output(of: &Composite, kind: OutputKind) -> &Tensor<3> {
    match kind {
        OutputKind::Image => &of.image,
        OutputKind::SurfelImage => &of.surfel_image,
        OutputKind::Transmittance => &of.transmittance,
        OutputKind::GaussianColour => &of.gaussian_colour,
        OutputKind::GaussianWeight => &of.gaussian_weight,
    }
}

/// Compares the gradients of a weighted sum of some outputs with central differences of the formulas.
fn check_gradients(flat: &Flat, kinds: &[OutputKind], detach: bool, seed: u64) {
    let leaves = flat.leaves();
    let rendered = flat.composite(&leaves, detach);
    let mut random = Random::new(seed);
    let images: Vec<&Tensor<3>> = kinds.iter().map(|kind| output(&rendered, *kind)).collect();
    let weights: Vec<Vec<f64>> =
        images.iter().map(|image| random.numbers(image.dims().iter().product(), -1.0, 1.0)).collect();
    let losses =
        images.iter().zip(&weights).map(|(image, weights)| ((*image).clone() * constant(weights, image.dims())).sum());
    let gradients = losses.reduce(|sum, loss| sum + loss).unwrap().backward();
    let found =
        [gradient_of(&leaves.0, &gradients), gradient_of(&leaves.1, &gradients), gradient_of(&leaves.2, &gradients)];
    for (i, found) in found.into_iter().enumerate() {
        let name = format!("{kinds:?} (K = {}, detach {detach}) with respect to {}", flat.layers, NAMES[i]);
        check(&name, &flat.values[i], &found, 1e-4, |moved| {
            let moved = Flat { values: replaced(&flat.values, i, moved), ..flat.clone() };
            let out = moved.composite_plainly(detach.then_some(flat));
            let weighted = |(kind, weights): (&OutputKind, &Vec<f64>)| -> f64 {
                out[*kind as usize].iter().zip(weights).map(|(a, b)| a * b).sum()
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
        for (kind, expected) in KINDS.into_iter().zip(expected) {
            assert_near(&values(output(&found, kind)), &expected, 1e-12);
        }
    }
}

#[test]
fn gradients_of_every_output_are_central_differences() {
    for layers in 1..=4 {
        let flat = Flat::random(layers, 10 + layers as u64);
        for (kind, detach) in KINDS.into_iter().flat_map(|kind| [(kind, false), (kind, true)]) {
            check_gradients(&flat, &[kind], detach, 3);
        }
    }
}

#[test]
fn a_loss_of_all_outputs_goes_back_from_all_of_them() {
    for detach in [false, true] {
        check_gradients(&Flat::random(3, 20), &KINDS, detach, 4);
    }
}

#[test]
fn gaussians_behind_an_opaque_first_layer_change_neither_image_nor_gradient() {
    let mut flat = Flat::random(3, 1);
    for at in 0..PLANE {
        (flat.ids[at], flat.values[0][at]) = (0, 1.0);
        for k in 1..3 {
            (flat.ids[k * PLANE + at], flat.values[0][k * PLANE + at]) = (-1, 0.0);
        }
    }
    let mut without = flat.clone();
    without.values[2][4 * PLANE..].fill(0.0);
    let leaves = flat.leaves();
    let image = flat.composite(&leaves, false).image;
    assert_eq!(values(&image), values(&without.composite(&without.leaves(), false).image));
    let sums = values(&leaves.2.grad(&image.sum().backward()).unwrap());
    assert!(sums[4 * PLANE..].iter().all(|g| *g == 0.0) && sums[..4 * PLANE].iter().any(|g| *g != 0.0));
}
