use super::gradients::{check_gradients, check_outputs};
use super::precision::check_single;
use super::probe::assert_same_probe;
use super::*;
use crate::ops::blend::{CORE, CORE_ALPHA, contributing};

const TRANSPARENCIES: [Transparency; 4] =
    [Transparency::Hybrid, Transparency::Nearest, Transparency::Sorted, Transparency::Tail];

/// Ellipsoids of several opacities, of which more than a core overlap near the axis.
fn crowd(count: usize) -> Flat {
    let mut random = Random::new(41);
    let mut flat = Flat::default();
    for i in 0..count {
        let numbers = |random: &mut Random, low, high| -> [f64; 3] { random.numbers(3, low, high).try_into().unwrap() };
        let [x, y, z] = numbers(&mut random, -1.0, 1.0);
        let [a, b, c] = numbers(&mut random, -1.0, 1.0);
        let (log_scales, colour) = (numbers(&mut random, -1.6, -1.0), numbers(&mut random, -0.2, 1.2));
        let opacity = [0.09, 0.3, 0.045, 0.12][i % 4] + 1e-4 * i as f64;
        flat.push_turned([0.4, a, b, c], [0.3 * x, 0.3 * y, 2.1 + 0.5 * z], log_scales, opacity, colour);
    }
    flat
}

fn small_camera() -> Camera {
    axis_camera().resized(19, 14)
}

fn scenes_to_blend() -> [(Flat, Camera); 3] {
    [(capped(), axis_camera()), Flat::random(42, 400, [45, 37]), (crowd(60), small_camera())]
}

#[test]
fn pictures_are_those_of_their_definition() {
    for options in TRANSPARENCIES.map(hybrid) {
        for (flat, camera) in scenes_to_blend() {
            // all but median depth
            check_pictures(&flat, &camera, &options, 1e-11, 1);
        }
    }
}

#[test]
fn a_crowd_has_fragments_beyond_its_core_and_faint_ones() {
    let (flat, camera, options) = (crowd(60), small_camera(), hybrid(Transparency::Hybrid));
    let alphas = |i: usize| -> Vec<f64> {
        let at = centre_of(&camera, i);
        let one = BlendOptions { min_transmittance: 1e-9, ..hybrid(Transparency::Tail) };
        flat.primitives(&camera, &options)
            .iter()
            .map(|primitive| pixel(&[*primitive], &camera, &one, at).planes[3])
            .collect()
    };
    let pixels: Vec<Vec<f64>> = (0..camera.width * camera.height).map(alphas).collect();
    let crowded = |alphas: &Vec<f64>| {
        let strong = alphas.iter().filter(|alpha| **alpha >= CORE_ALPHA).count();
        strong > CORE && alphas.iter().any(|alpha| *alpha > 0.0 && *alpha < CORE_ALPHA)
    };
    assert!(pixels.iter().filter(|alphas| crowded(alphas)).count() > 30);
}

#[test]
fn gradients_of_every_transparency_are_central_differences() {
    for options in TRANSPARENCIES.map(hybrid) {
        check_outputs(&capped(), &options);
    }
}

#[test]
fn gradients_of_a_crowd_are_central_differences() {
    let camera = axis_camera().resized(6, 5);
    let camera = Camera { fx: 3.0 * camera.fx, fy: 3.0 * camera.fy, ..camera };
    let flat = crowd(40);
    for options in TRANSPARENCIES.map(hybrid) {
        check_gradients(&flat, &camera, &options, &[Output::Colour, Output::Depth], 1e-7);
    }
}

#[test]
fn median_depth_is_that_of_the_core_or_the_mean_of_the_tail() {
    let camera = axis_camera();
    let median = |opacities: [f64; 2], transparency: Transparency| {
        let mut flat = Flat::default();
        flat.push([0.0, 0.0, 2.0], [-1.0; 3], opacities[0], [0.5; 3]);
        flat.push([0.0, 0.0, 3.0], [-1.0; 3], opacities[1], [0.5; 3]);
        images(&flat.leaves().blend(&camera, &hybrid(transparency)))[5][BESIDE_AXIS]
    };
    assert!((median([0.8, 0.8], Transparency::Hybrid) - 2.0).abs() < 0.01);
    assert!((median([0.3, 0.8], Transparency::Hybrid) - 3.0).abs() < 0.01);
    assert_eq!(median([0.2, 0.2], Transparency::Hybrid), 0.0);
    assert!((median([0.8, 0.8], Transparency::Tail) - 2.5).abs() < 0.01);
    assert_eq!(median([0.2, 0.2], Transparency::Tail), 0.0);
}

/// Half the depth of each centre times what pixels want of it, by central differences of the camera.
#[test]
fn the_probe_collects_what_every_pixel_wants_of_the_centre() {
    const STEP: f64 = 1e-6;
    let camera = axis_camera().resized(8, 6);
    let flat = capped();
    for options in TRANSPARENCIES.map(hybrid) {
        let found = flat.leaves().gradients(&[Output::Colour], &camera, &options);
        let pixels = camera.width * camera.height;
        let weights = Output::Colour.weights(pixels);
        let mut expected = vec![0.0; 4 * flat.len()];
        for (row, axis) in (0..flat.len()).flat_map(|row| [(row, 0), (row, 1), (row, 2)]) {
            let half_depth = 0.5 * flat.0[0][3 * row + 2];
            let at = |by: f64| {
                let mut flat = flat.clone();
                flat.0[0][3 * row + axis] += by;
                images(&flat.leaves().blend(&camera, &options))[0].clone()
            };
            let (above, below) = (at(STEP), at(-STEP));
            for i in 0..pixels {
                let of_channel = |c: usize| (above[c * pixels + i] - below[c * pixels + i]) * weights[c * pixels + i];
                let wants = half_depth * (0..3).map(of_channel).sum::<f64>() / (2.0 * STEP);
                expected[4 * row + axis] += wants;
                expected[4 * row + 3] += wants.abs();
            }
        }
        assert!(assert_same_probe(&found[5], &expected) > 0.1);
    }
}

#[test]
fn single_precision_is_close_to_double_and_so_are_its_gradients() {
    let (flat, camera) = Flat::random(14, 300, [61, 40]);
    for options in TRANSPARENCIES.map(hybrid) {
        check_single(&flat, &camera, &options, &OUTPUTS[..4], [1e-2, 3e-2]);
    }
}

#[test]
fn those_that_outweigh_a_share_are_marked() {
    let (flat, camera) = (crowd(60), small_camera());
    let leaves = flat.leaves();
    let g = leaves.gaussians.clone();
    let gaussians = Gaussians {
        positions: g.positions.inner(),
        quaternions: g.quaternions.inner(),
        log_scales: g.log_scales.inner(),
        opacities: g.opacities.inner(),
        ..leaves.gaussians.clone()
    };
    for (options, least) in TRANSPARENCIES.into_iter().flat_map(|t| [0.01, 0.08].map(|least| (hybrid(t), least))) {
        let marks = contributing(&gaussians, &camera, &options, least).unwrap();
        let found: Vec<i32> = marks.into_data().convert::<i32>().to_vec().unwrap();
        // the weight of a primitive is how a pixel changes with its colour
        let weighs = |row: usize| {
            let mut brighter = flat.clone();
            brighter.0[4][3 * row] += 1.0;
            let [before, after] =
                [&flat, &brighter].map(|flat| images(&flat.leaves().blend(&camera, &options))[0].clone());
            i32::from(before.iter().zip(&after).any(|(before, after)| after - before >= least))
        };
        let expected: Vec<i32> = (0..flat.len()).map(weighs).collect();
        assert_eq!(found, expected, "{} {least}", options.order);
        let marked: i32 = expected.iter().sum();
        assert!(marked > 0 && (marked as usize) < flat.len(), "{} {least}: {marked}", options.order);
    }
    let error = contributing(&gaussians, &camera, &by_rays(), 0.01).unwrap_err().to_string();
    assert!(error.contains("`order`") && error.contains("rays"), "{error}");
}

#[test]
fn orders_belong_to_their_forms() {
    let forms = [Form::Ellipsoids, Form::Discs, Form::Students, Form::Whitened];
    let orders = [BlendOrder::Centres, BlendOrder::Rays, BlendOrder::Whitened(Transparency::Tail)];
    let fits = |form, order| BlendOptions { form, order, ..BlendOptions::default() }.validate().is_ok();
    assert_eq!(
        forms.map(|form| orders.map(|order| fits(form, order))),
        [[true, true, false], [true, false, false], [true, false, false], [false, false, true]]
    );
}
