use burn::tensor::Tensor;

use super::{PhotometricWeights, photometric, ssim};
use crate::ops::fixtures::constant;
use crate::testing::device;
use crate::testing::golden::values;
use crate::testing::gradients::{check_elements, leaf};
use crate::testing::random::Random;

type Image = (Vec<f64>, [usize; 3]);

fn random_image(shape: [usize; 3], seed: u64) -> Image {
    (Random::new(seed).numbers(shape.iter().product(), 0.0, 1.0), shape)
}

fn tensor((values, shape): &Image) -> Tensor<3> {
    leaf(values, *shape, &device())
}

/// The definition: a two-dimensional window around every pixel, zero outside the image.
fn ssim_plainly((a, shape): &Image, (b, _): &Image) -> f64 {
    let [channels, height, width] = *shape;
    let tap = |offset: i64| (-(offset * offset) as f64 / (2.0 * 1.5 * 1.5)).exp();
    let total: f64 = (-5..=5).map(tap).sum();
    let mut sum = 0.0;
    for (channel, y, x) in (0..channels).flat_map(|c| (0..height).flat_map(move |y| (0..width).map(move |x| (c, y, x))))
    {
        let [mut ma, mut mb, mut aa, mut bb, mut ab] = [0.0; 5];
        for (dy, dx) in (-5..=5i64).flat_map(|dy| (-5..=5i64).map(move |dx| (dy, dx))) {
            let (row, column) = (y as i64 + dy, x as i64 + dx);
            if (0..height as i64).contains(&row) && (0..width as i64).contains(&column) {
                let at = (channel * height + row as usize) * width + column as usize;
                let weight = tap(dy) * tap(dx) / (total * total);
                ma += weight * a[at];
                mb += weight * b[at];
                aa += weight * a[at] * a[at];
                bb += weight * b[at] * b[at];
                ab += weight * a[at] * b[at];
            }
        }
        let (c1, c2) = (0.0001, 0.0009);
        sum += (2.0 * ma * mb + c1) * (2.0 * (ab - ma * mb) + c2)
            / ((ma * ma + mb * mb + c1) * (aa - ma * ma + bb - mb * mb + c2));
    }
    sum / (channels * height * width) as f64
}

#[test]
fn separable_windows_equal_two_dimensional_ones() {
    for shape in [[3, 24, 31], [3, 4, 3], [1, 1, 1], [2, 1, 20], [3, 13, 2], [3, 11, 11]] {
        let (a, b) = (random_image(shape, 1), random_image(shape, 2));
        let found = values(&ssim(&tensor(&a), &tensor(&b)).unwrap())[0];
        approx::assert_relative_eq!(found, ssim_plainly(&a, &b), epsilon = 1e-12);
    }
}

#[test]
fn the_gradient_is_central_differences() {
    for shape in [[3, 18, 21], [2, 3, 4], [1, 1, 1]] {
        let (image, target) = (random_image(shape, 4), random_image(shape, 5));
        let a = tensor(&image);
        // not of unit weight: the incoming gradient is used
        let loss = |a: Tensor<3>| ssim(&a, &tensor(&target).detach()).unwrap() * -3.0;
        let gradient = values(&a.grad(&loss(a.clone()).backward()).unwrap());
        let elements: Vec<usize> = (0..gradient.len()).step_by(1 + gradient.len() / 150).collect();
        check_elements(&format!("SSIM of {shape:?}"), &image.0, &gradient, &elements, 1e-5, |moved| {
            values(&loss(tensor(&(moved.to_vec(), shape))))[0]
        });
    }
}

#[test]
fn images_of_different_shapes_are_refused() {
    let error = ssim(&tensor(&random_image([3, 4, 5], 1)), &tensor(&random_image([3, 5, 4], 1))).unwrap_err();
    assert_eq!(error.to_string(), "tensor `target` has shape [3, 5, 4], expected [3, 4, 5]");
}

const SHAPE: [usize; 3] = [3, 17, 19];
const AREA: usize = SHAPE[1] * SHAPE[2];

/// A rectangle, a row at the border and a lone pixel do not count.
fn is_ignored(pixel: usize) -> bool {
    let (x, y) = (pixel % SHAPE[2], pixel / SHAPE[2]);
    ((4..9).contains(&x) && (5..12).contains(&y)) || y == 0 || pixel == AREA - 20
}

fn mask() -> Tensor<3> {
    let ignored: Vec<f64> = (0..AREA).map(|pixel| f64::from(u8::from(is_ignored(pixel)))).collect();
    constant(&ignored, [1, SHAPE[1], SHAPE[2]])
}

fn weights(masked: bool) -> PhotometricWeights {
    let ignored = (0..AREA).filter(|&pixel| masked && is_ignored(pixel)).count();
    let pixels_per_counted = AREA as f64 / (AREA - ignored) as f64;
    PhotometricWeights { offset: 0.3, l1: 0.7, ssim: -0.4, pixels_per_counted }
}

/// The weighted sum and the squared error by their definitions.
fn plainly((a, shape): &Image, (b, _): &Image, masked: bool) -> [f64; 2] {
    let counts = |at: usize| !(masked && is_ignored(at % AREA));
    let b: Vec<f64> = (0..a.len()).map(|at| if counts(at) { b[at] } else { a[at] }).collect();
    let mean = |of: &dyn Fn(usize) -> f64| (0..a.len()).map(of).sum::<f64>() / a.len() as f64;
    let l1 = mean(&|at| (a[at] - b[at]).abs());
    let error = mean(&|at| if counts(at) { (a[at].clamp(0.0, 1.0) - b[at]).powi(2) } else { 0.0 });
    let PhotometricWeights { offset, l1: l1_weight, ssim, pixels_per_counted } = weights(masked);
    let similarity = ssim_plainly(&(a.clone(), *shape), &(b, *shape));
    [offset + l1_weight * l1 + ssim * similarity, error].map(|value| value * pixels_per_counted)
}

/// An image that reaches beyond [0, 1].
fn bright_image(seed: u64) -> Image {
    (Random::new(seed).numbers(3 * AREA, -0.2, 1.3), SHAPE)
}

#[test]
fn the_value_and_the_squared_error_are_the_formulas_of_what_counts() {
    let (image, target) = (bright_image(6), random_image(SHAPE, 7));
    for masked in [false, true] {
        let mask = masked.then(mask);
        let found = photometric(&tensor(&image), &tensor(&target), mask.as_ref(), &weights(masked)).unwrap();
        let found = [values(&found.value)[0], values(&found.squared_error)[0]];
        for (found, expected) in found.into_iter().zip(plainly(&image, &target, masked)) {
            approx::assert_relative_eq!(found, expected, max_relative = 1e-12);
        }
    }
}

#[test]
fn the_gradient_is_central_differences_of_what_counts_and_0_elsewhere() {
    let (image, target) = (bright_image(8), random_image(SHAPE, 9));
    for masked in [false, true] {
        let (a, mask) = (tensor(&image), masked.then(mask));
        let found = photometric(&a, &tensor(&target).detach(), mask.as_ref(), &weights(masked)).unwrap();
        let gradient = values(&a.grad(&(found.value * -2.0).backward()).unwrap());
        let counts = |at: &usize| !(masked && is_ignored(at % AREA));
        assert!(
            (0..gradient.len()).all(|at| counts(&at) || gradient[at] == 0.0),
            "what does not count has no gradient"
        );
        let elements: Vec<usize> = (0..gradient.len()).filter(counts).step_by(5).collect();
        check_elements(&format!("image, masked {masked}"), &image.0, &gradient, &elements, 1e-5, |moved| {
            -2.0 * plainly(&(moved.to_vec(), SHAPE), &target, masked)[0]
        });
    }
}

#[test]
fn masks_of_another_size_are_refused() {
    let (image, mask) = (tensor(&random_image([3, 4, 5], 1)), mask());
    let error = photometric(&image, &image, Some(&mask), &weights(true)).unwrap_err();
    assert_eq!(error.to_string(), "tensor `mask` has shape [1, 17, 19], expected [1, 4, 5]");
}
