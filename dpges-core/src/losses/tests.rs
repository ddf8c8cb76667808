use burn::tensor::{DType, Tensor};

use super::geometry::{Supervision, normal_consistency};
use super::{LossWeights, Mask, PackedMask, Target, losses, rgb};
use crate::render::{Render, RenderOptions, render};
use crate::testing::device;
use crate::testing::golden::values;
use crate::testing::gradients::leaf;
use crate::testing::masked::{AREA, HEIGHT, WIDTH, counted, mask, overpainted};
use crate::testing::random::Random;
use crate::testing::scenes::{self, Recipe};

fn image(values: &[f64]) -> Tensor<3> {
    leaf(values, [3, HEIGHT, WIDTH], &device())
}

#[test]
fn what_a_photograph_shows_where_pixels_do_not_count_is_of_no_effect() {
    let mut random = Random::new(3);
    let [shown, photograph, garbage] = [0; 3].map(|_| random.numbers(3 * AREA, 0.0, 1.0));
    let of = |photograph: &[f64]| {
        let shown = image(&shown);
        let target = Target { image: image(photograph).detach(), mask: Some(mask(&counted())) };
        let loss = rgb(&shown, target, 0.2).unwrap().total;
        (values(&loss), values(&shown.grad(&loss.backward()).unwrap()))
    };
    let (loss, gradient) = of(&photograph);
    assert_eq!((loss.clone(), gradient.clone()), of(&overpainted(&photograph, &garbage)));
    for (at, gradient) in gradient.iter().enumerate() {
        assert_eq!(*gradient != 0.0, counted()[at % AREA], "pixel {}", at % AREA);
    }
    let other: Vec<f64> = photograph.iter().map(|value| 1.0 - value).collect();
    assert_ne!(loss, of(&other).0);
}

/// With any number of pixels in the last word, on a tape and off it.
#[test]
fn a_packed_mask_is_the_mask_to_the_bit() {
    for device in [device(), device().inner()] {
        for area in [1, 2, 3, 4, 437] {
            let counted: Vec<bool> = (0..area).map(|pixel| pixel % 3 < 2).collect();
            let mask = PackedMask::new(&counted, area, 1, &device).unwrap().mask();
            assert_eq!(
                mask.pixels_per_counted(),
                area as f64 / counted.iter().filter(|&&counts| counts).count() as f64
            );
            let image = Tensor::zeros([3, 1, area], (&device, DType::F32));
            let target = Target { image, mask: Some(mask) };
            let ignored = target.ignored().unwrap();
            assert_eq!(
                (ignored.dims(), ignored.dtype(), ignored.is_autodiff()),
                ([1, 1, area], DType::F32, device.is_autodiff())
            );
            let expected: Vec<f64> = counted.iter().map(|&counts| if counts { 0.0 } else { 1.0 }).collect();
            assert_eq!(values(ignored), expected);
            assert_eq!(PackedMask::size_bytes(area), area.div_ceil(4) * 4);
        }
    }
}

#[test]
fn means_are_those_over_the_pixels_that_count() {
    let (shown, photograph) = (vec![0.5; 3 * AREA], vec![0.25; 3 * AREA]);
    let target = |counted: &[bool]| Target { image: image(&photograph).detach(), mask: Some(mask(counted)) };
    let loss = rgb(&image(&shown), target(&counted()), 0.0).unwrap().total;
    approx::assert_relative_eq!(values(&loss)[0], 0.25, max_relative = 1e-12);

    let mut random = Random::new(4);
    let [shown, photograph] = [0; 2].map(|_| random.numbers(3 * AREA, 0.0, 1.0));
    let all = Target { image: image(&photograph).detach(), mask: Some(mask(&[true; AREA])) };
    let plain = rgb(&image(&shown), image(&photograph).detach(), 0.2).unwrap().total;
    assert_eq!(values(&rgb(&image(&shown), all, 0.2).unwrap().total), values(&plain));
}

/// A loss of a view of some surfels and Gaussians and their log-scales, and its gradient with respect to positions of surfels.
fn of_a_view(loss: impl Fn(&Render, Tensor<2>) -> Tensor<1>) -> (Vec<f64>, Vec<f64>) {
    let recipe = Recipe { surfels: 12, gaussians: 20, width: WIDTH, height: HEIGHT, ..Recipe::default() };
    let scene = scenes::random(11, &recipe);
    let (surfels, gaussians) = scene.leaves(&device(), DType::F64);
    let rendered = render(&surfels, &gaussians, &scene.camera, &RenderOptions::default()).unwrap();
    let loss = loss(&rendered, surfels.log_scales.clone());
    (values(&loss), values(&surfels.positions.grad(&loss.backward()).unwrap()))
}

#[test]
fn all_terms_of_a_view_leave_out_what_does_not_count() {
    let mut random = Random::new(6);
    let [photograph, garbage] = [0; 2].map(|_| random.numbers(3 * AREA, 0.0, 1.0));
    let weights = LossWeights { surfel: 0.5, transmittance: 0.5, ..LossWeights::default() };
    let total = |photograph: &[f64]| {
        let target = Target { image: image(photograph).detach(), mask: Some(mask(&counted())) };
        of_a_view(|rendered, log_scales| losses(rendered, log_scales, target.clone(), &weights).unwrap().total)
    };
    let found = total(&photograph);
    assert!(found.1.iter().any(|&g| g != 0.0), "a surfel is seen");
    assert_eq!(found, total(&overpainted(&photograph, &garbage)));
}

#[test]
fn a_view_goes_back_from_any_of_its_terms() {
    let photograph = Random::new(6).numbers(3 * AREA, 0.0, 1.0);
    let total = |surfel: f64, transmittance: f64| {
        let weights = LossWeights { surfel, transmittance, ..LossWeights::default() };
        let target = image(&photograph).detach();
        of_a_view(|rendered, log_scales| losses(rendered, log_scales, target.clone(), &weights).unwrap().total).1
    };
    let [none, surfel, transmittance, both] = [total(0.0, 0.0), total(0.5, 0.0), total(0.0, 0.5), total(0.5, 0.5)];
    let (_, alone) = of_a_view(|rendered, _| super::transmittance(rendered));
    assert!(alone.iter().any(|&g| g != 0.0), "two surfels are seen one behind the other");
    for at in 0..none.len() {
        let sums = [surfel[at] + transmittance[at] - none[at], none[at] + 0.5 * alone[at]];
        for (found, sum) in [both[at], transmittance[at]].into_iter().zip(sums) {
            approx::assert_relative_eq!(found, sum, epsilon = 1e-12, max_relative = 1e-9);
        }
    }
}

#[test]
fn geometry_is_unknown_where_pixels_do_not_count() {
    let ones = |planes: usize| Tensor::<3>::ones([planes, HEIGHT, WIDTH], (&device(), DType::F64));
    let mask = mask(&counted());
    let Supervision { depth, normal } = Supervision { depth: ones(1), normal: ones(3) }.within(&mask);
    let expected: Vec<f64> = counted().iter().map(|&counts| f64::from(u8::from(counts))).collect();
    assert_eq!((values(&depth), values(&normal)), (expected.clone(), expected.repeat(3)));
    // 1 − N · Ñ is −2 where it counts
    let consistency = normal_consistency(ones(3), ones(3), ones(1), Some(&mask));
    approx::assert_relative_eq!(values(&consistency)[0], -2.0, max_relative = 1e-12);
}

#[test]
fn masks_of_no_use_are_refused() {
    let none = Mask::new(&[false; AREA], WIDTH, HEIGHT, &device()).unwrap_err().to_string();
    assert!(none.contains("mask") && none.contains("none"), "{none}");
    let few = Mask::new(&[true; 3], WIDTH, HEIGHT, &device()).unwrap_err().to_string();
    assert!(few.contains("mask") && few.contains("19"), "{few}");
}
