use burn::tensor::Tensor;

use super::ssim;
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
fn identical_images_are_perfectly_similar_and_cannot_become_more_so() {
    let image = random_image([3, 20, 17], 3);
    let a = tensor(&image);
    let value = ssim(&a, &tensor(&image).detach()).unwrap();
    approx::assert_relative_eq!(values(&value)[0], 1.0, epsilon = 1e-14);
    let gradient = values(&a.grad(&value.backward()).unwrap());
    assert!(gradient.iter().all(|g| g.abs() < 1e-14), "{gradient:?}");
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
