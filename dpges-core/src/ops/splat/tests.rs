mod lens;

use std::ops::Range;

use burn::tensor::Tensor;
use glam::{DMat3, DVec2, DVec3};

use super::{contributions, splat, splat_probed};
use crate::camera::Camera;
use crate::footprint::CUTOFF;
use crate::footprint::gaussian::cpu::{MIN_COMPENSATION_SQUARED, Parameters, Splat};
use crate::math::{CameraOf, rotation};
use crate::ops::fixtures::{Flat, NAMES, axis_camera, constant, replaced, weights};
use crate::scene::ScreenFilter;
use crate::scene::peeling::STEP;
use crate::testing::device;
use crate::testing::golden::values;
use crate::testing::gradients::{check, leaf};
use crate::testing::random::Random;
use crate::tiles::PixelRect;

const COLOUR: [f64; 3] = [0.9, -0.2, 0.4];

impl Flat {
    fn splat(&self, limits: &Tensor<3>, camera: &Camera) -> Tensor<4> {
        let (gaussians, colours) = self.gaussians();
        splat(&gaussians, &colours, limits, camera).unwrap()
    }

    /// Weight of a Gaussian at every pixel, and its depth, by the formulas of the specification.
    fn weights_densely(&self, i: usize, camera: &Camera) -> (Vec<f64>, f64) {
        let (w, h) = (camera.width as f64, camera.height as f64);
        let pose = &camera.camera_from_world;
        let c = pose.rotation * DVec3::from(self.row::<3>(0, i)) + pose.translation;
        let pixels = camera.width * camera.height;
        let depth = camera.lens.map_or(c.z, |lens| lens.depth(c.to_array()));
        let seen = camera.lens.and_then(|lens| lens.look(c.to_array()));
        let shown = match (&camera.lens, &seen) {
            (None, _) => true,
            (Some(_), seen) => seen.is_some_and(|seen| DVec2::from(seen.position).length() <= camera.coverage()),
        };
        if depth <= camera.near || !shown {
            return (vec![0.0; pixels], depth);
        }
        let slope = |slope: f64, principal: f64, focal: f64, size: f64| {
            slope.clamp(-principal / focal - 0.15 * size / focal, (size - principal) / focal + 0.15 * size / focal)
        };
        let sx = slope(c.x / c.z, camera.cx, camera.fx, w);
        let sy = slope(c.y / c.z, camera.cy, camera.fy, h);
        let rows = rotation(self.row::<4>(1, i));
        let turn = DMat3::from_cols_array_2d(&rows).transpose();
        let factor = pose.rotation * turn * DMat3::from_diagonal(DVec3::from(self.row::<3>(2, i)).exp());
        let mut jacobian =
            [DVec3::new(camera.fx, 0.0, -camera.fx * sx) / c.z, DVec3::new(0.0, camera.fy, -camera.fy * sy) / c.z];
        if let Some(seen) = &seen {
            let [x, y] = seen.jacobian.map(DVec3::from);
            jacobian = [x * camera.fx, y * camera.fy];
        }
        let half = jacobian.map(|row| factor.transpose() * row);
        let unfiltered = half[0].cross(half[1]).length_squared();
        let trace = half[0].length_squared() + half[1].length_squared();
        let low_pass = ScreenFilter::Compensated.variance();
        let determinant = unfiltered + low_pass * trace + low_pass * low_pass;
        let (a, b, d) =
            (half[0].length_squared() + low_pass, half[0].dot(half[1]), half[1].length_squared() + low_pass);
        let strength = self.0[3][i].max(0.0) * (unfiltered / determinant).max(MIN_COMPENSATION_SQUARED).sqrt();
        let [x, y] = seen.map_or([c.x / c.z, c.y / c.z], |seen| seen.position);
        let mean = [camera.fx * x + camera.cx, camera.fy * y + camera.cy];
        let weight = |at: usize| {
            let dx = (at % camera.width) as f64 + 0.5 - mean[0];
            let dy = (at / camera.width) as f64 + 0.5 - mean[1];
            let weight = strength * (-0.5 * (d * dx * dx - 2.0 * b * dx * dy + a * dy * dy) / determinant).exp();
            if weight >= CUTOFF { weight } else { 0.0 }
        };
        ((0..pixels).map(weight).collect(), depth)
    }

    /// Sums [K, 4, H, W], and the largest weight · share · gate · max|colour| of every Gaussian.
    fn splat_densely(&self, limits: &[f64], gates: &[f64], camera: &Camera) -> (Vec<f64>, Vec<f64>) {
        let pixels = camera.width * camera.height;
        let layers = limits.len() / pixels - 1;
        let (mut sums, mut largest) = (vec![0.0; 4 * layers * pixels], vec![0.0f64; self.len()]);
        for (i, largest) in largest.iter_mut().enumerate() {
            let (weights, depth) = self.weights_densely(i, camera);
            let colour = self.row::<3>(4, i);
            let brightest = colour.iter().fold(0.0, |m: f64, c| m.max(c.abs()));
            for (at, weight) in weights.into_iter().enumerate() {
                let slope = limits[layers * pixels + at];
                let mut nearer = 0.0;
                for k in 0..layers {
                    let before = ((limits[k * pixels + at] - depth) * slope).clamp(0.0, 1.0);
                    let share = weight * (before - nearer);
                    for (c, value) in [colour[0], colour[1], colour[2], 1.0].into_iter().enumerate() {
                        sums[(4 * k + c) * pixels + at] += share * value;
                    }
                    *largest = largest.max(share * gates[k * pixels + at] * brightest);
                    nearer = before;
                }
            }
        }
        (sums, largest)
    }
}

/// Limits [K + 1, H, W]: ascending ones around `depth`, and slopes, of which every third is that of a step.
fn random_limits(layers: usize, depth: f64, camera: &Camera, seed: u64) -> Vec<f64> {
    let (mut random, pixels) = (Random::new(seed), camera.width * camera.height);
    let mut limits = vec![f64::INFINITY; (layers + 1) * pixels];
    for at in 0..pixels {
        let mut stack = random.numbers(layers, 0.4 * depth, 1.6 * depth);
        stack.sort_by(f64::total_cmp);
        if random.below(3) == 0 {
            stack[layers - 1] = f64::INFINITY;
        }
        stack.into_iter().enumerate().for_each(|(k, limit)| limits[k * pixels + at] = limit);
        limits[layers * pixels + at] = if at % 3 == 0 { STEP } else { random.between(0.5, 20.0) / depth };
    }
    limits
}

fn image(values: &[f64], layers: usize, camera: &Camera) -> Tensor<3> {
    constant(values, [layers, camera.height, camera.width])
}

fn assert_close(found: &[f64], expected: &[f64], relative: f64) {
    assert_eq!(found.len(), expected.len());
    let largest = expected.iter().fold(0.0, |m: f64, v| m.max(v.abs()));
    for (at, (&a, &b)) in found.iter().zip(expected).enumerate() {
        let close = (a - b).abs() <= relative * (b.abs() + largest * 1e-3);
        assert!(close && (a == 0.0) == (b == 0.0), "at {at}: {a}, expected {b}");
    }
}

/// Needles, huge, tiny, off the frustum, around the near plane, strong, faint and negative ones.
fn every_kind(count: usize) -> Flat {
    let (mut random, mut flat) = (Random::new(11), Flat::default());
    for i in 0..count {
        let depth = if i % 7 == 0 { random.between(-0.2, 0.6) } else { random.between(0.6, 6.0) };
        let spread = if i % 5 == 0 { 2.0 } else { 0.4 };
        let position = [random.normal() * spread * depth, random.normal() * spread * depth, depth];
        let log_scales = match i % 4 {
            0 => std::array::from_fn(|_| random.between(-3.0, -0.5)),
            1 => [random.between(-1.0, 1.0), -6.0, -7.0],
            2 => std::array::from_fn(|_| random.between(0.5, 3.0)),
            _ => std::array::from_fn(|_| random.between(-9.0, -3.0)),
        };
        let opacity = [0.7, 3.0, 0.02, -0.5, 1.0][random.below(5)];
        flat.push_turned(std::array::from_fn(|_| random.normal()), position, log_scales, opacity, COLOUR);
    }
    flat
}

/// Compares sums and contributions with dense ones.
fn check_against_dense(name: &str, flat: &Flat, layers: usize, depth: f64, camera: &Camera, tolerance: f64) {
    let limits = random_limits(layers, depth, camera, 1);
    let gates = Random::new(2).numbers(layers * camera.width * camera.height, 0.0, 1.0);
    let (sums, largest) = flat.splat_densely(&limits, &gates, camera);
    assert!(sums.iter().filter(|s| **s != 0.0).count() > sums.len() / 4, "{name}");
    let (limits, gates) = (image(&limits, layers + 1, camera), image(&gates, layers, camera));
    assert_close(&values(&flat.splat(&limits, camera)), &sums, tolerance);
    let (gaussians, colours) = flat.gaussians();
    let found = contributions(&gaussians, &colours, &limits, &gates, camera).unwrap();
    assert_close(&values(&found), &largest, tolerance);
}

#[test]
fn tiled_sums_and_contributions_equal_dense_ones() {
    for layers in 1..=4 {
        let (random, random_camera) = Flat::random(layers as u64, 60, [45, 37]);
        check_against_dense("random", &random, layers, 2.5, &random_camera, 1e-11);
        check_against_dense("every kind", &every_kind(400), layers, 2.5, &axis_camera(), 1e-11);
    }
}

#[test]
fn reach_is_the_box_of_the_ellipse_of_the_cutoff() {
    const MAGNIFIED: f64 = 1e3;
    let camera = axis_camera().resized(40 * MAGNIFIED as usize, 30 * MAGNIFIED as usize);
    let (of, flat, mut compared) = (CameraOf::<f64>::new(&camera), every_kind(400), 0);
    for i in 0..flat.len() {
        let splat = Splat::new(&of, &flat.parameters(i), flat.row(4, i), ScreenFilter::Compensated);
        let Some(splat) = splat else { continue };
        let [p, q, r] = splat.root;
        let squared = 2.0 * (splat.strength / CUTOFF).ln();
        // θ → offset with (u, v) = (cos θ, sin θ)
        let mut bounds = [f64::INFINITY, f64::NEG_INFINITY, f64::INFINITY, f64::NEG_INFINITY];
        for step in 0..20_000 {
            let (sin, cos) = (f64::from(step) * std::f64::consts::TAU / 20_000.0).sin_cos();
            let dy = sin / r;
            let dx = (cos - q * dy) / p;
            let (x, y) = (splat.mean[0] + squared.sqrt() * dx, splat.mean[1] + squared.sqrt() * dy);
            bounds = [bounds[0].min(x), bounds[1].max(x), bounds[2].min(y), bounds[3].max(y)];
        }
        let expected = PixelRect::covering(bounds, camera.width, camera.height);
        let found = splat.reach(camera.width, camera.height);
        let sides = |r: &PixelRect| [r.x0, r.x1, r.y0, r.y1].map(i64::from);
        // rounding slack grows with the size
        let slack = 2 + (1e-5 * (bounds[1] - bounds[0]).max(bounds[3] - bounds[2])) as i64;
        let apart = sides(&found).iter().zip(sides(&expected)).map(|(a, b)| (a - b).abs()).max().unwrap();
        let thin = |r: &PixelRect| i64::from((r.x1 - r.x0).min(r.y1 - r.y0)) <= slack;
        assert!(apart <= slack || thin(&found) && thin(&expected), "{i}: {found:?}, expected {expected:?}");
        compared += usize::from(!expected.is_empty());
    }
    assert!(compared > 80, "{compared}");
}

#[test]
fn a_gaussian_at_a_limit_lies_behind_it() {
    let camera = axis_camera();
    let mut gaussian = Flat::default();
    gaussian.push_turned([1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 2.0], [-2.0; 3], 1.0, COLOUR);
    let pixels = camera.width * camera.height;
    let weight_of = |limits: [f64; 2]| {
        let planes: Vec<f64> = limits.into_iter().chain([STEP]).flat_map(|limit| vec![limit; pixels]).collect();
        let sums = values(&gaussian.splat(&image(&planes, 3, &camera), &camera));
        [3, 7].map(|channel| sums[channel * pixels..][..pixels].iter().sum::<f64>() > 0.0)
    };
    assert_eq!(weight_of([2.0, 3.0]), [false, true]);
    assert_eq!(weight_of([2.0f64.next_up(), 3.0]), [true, false]);
    assert_eq!(weight_of([1.0, 2.0]), [false, false]);
    assert_eq!(weight_of([2.0, 2.0]), [false, false]);
    assert_eq!(weight_of([1.0, f64::INFINITY]), [false, true]);
}

#[test]
fn no_gaussians_sum_to_nothing() {
    let camera = axis_camera();
    let limits = image(&random_limits(3, 2.0, &camera, 4), 4, &camera);
    let gates = limits.clone().slice_dim(0, 0..3);
    let (gaussians, colours) = Flat::default().gaussians();
    let sums = splat(&gaussians, &colours, &limits, &camera).unwrap();
    assert!(values(&sums).iter().all(|s| *s == 0.0));
    assert_eq!(sums.dims(), [3, 4, camera.height, camera.width]);
    assert_eq!(contributions(&gaussians, &colours, &limits, &gates, &camera).unwrap().dims(), [0]);
}

/// Compares the gradients of weighted sums with central differences: those of positions between steps, as shares have none.
fn check_gradients(name: &str, flat: &Flat, camera: &Camera) {
    let ramps = random_limits(3, 2.5, camera, 5);
    let mut steps = ramps.clone();
    steps[3 * camera.width * camera.height..].fill(STEP);
    check_gradients_between(name, 0..1, flat, &image(&steps, 4, camera), camera);
    check_gradients_between(name, 1..5, flat, &image(&ramps, 4, camera), camera);
}

fn check_gradients_between(name: &str, attributes: Range<usize>, flat: &Flat, limits: &Tensor<3>, camera: &Camera) {
    let weights = weights(9, [3, 4, camera.height, camera.width]);
    let loss = |sums: Tensor<4>| (sums * weights.clone()).sum();
    let (g, colours) = flat.gaussians();
    let gradients = loss(splat(&g, &colours, limits, camera).unwrap()).backward();
    let leaves = [&g.positions, &g.quaternions, &g.log_scales, &g.opacities, &colours];
    for i in attributes {
        let found = values(&leaves[i].grad(&gradients).unwrap());
        check(&format!("{name}: {}", NAMES[i]), &flat.0[i], &found, 1e-6, |moved| {
            let flat = Flat(replaced(&flat.0, i, moved), Vec::new());
            values(&loss(flat.splat(limits, camera)))[0]
        });
    }
}

#[test]
fn gradients_of_the_sums_are_central_differences() {
    let mut edges = Flat::default();
    // a needle, one larger than the image, one outside where the Jacobian is clamped, one too thin to be undimmed
    edges.push_turned([0.9, 0.3, -0.2, 0.1], [0.1, 0.0, 2.0], [-0.7, -4.0, -5.0], 1.3, COLOUR);
    edges.push_turned([0.5, -0.3, 0.6, 0.2], [-0.3, 0.2, 3.0], [0.3, 0.6, 0.1], 0.8, COLOUR);
    edges.push_turned([0.1, 0.8, 0.2, 0.4], [1.6, 0.9, 2.0], [-0.6, -0.3, -0.9], 0.9, COLOUR);
    edges.push_turned([0.1, 0.3, 0.2, 0.4], [0.2, -0.2, 2.0], [-8.0, -9.0, -9.5], 1.9, COLOUR);
    let (random, random_camera) = Flat::random(31, 9, [29, 21]);
    check_gradients("random", &random, &random_camera);
    check_gradients("edges", &edges, &axis_camera());
}

/// A camera whose principal point moves, so that the projected centre of a Gaussian in the middle does.
#[test]
fn the_probe_collects_what_the_sums_want_of_the_projected_centre() {
    const STEP: f64 = 1e-6;
    let (camera, shapes) = (axis_camera(), [[-1.2, -2.0, -1.5], [-0.5, -4.0, -3.0], [-4.5, -4.6, -4.4]]);
    let limits = image(&vec![f64::INFINITY; 2 * camera.width * camera.height], 2, &camera);
    let weights = weights(9, [1, 4, camera.height, camera.width]);
    for (filter, log_scales) in [ScreenFilter::Compensated, ScreenFilter::Plain]
        .into_iter()
        .flat_map(|filter| shapes.map(|shape| (filter, shape)))
    {
        let mut gaussian = Flat::default();
        gaussian.push_turned([0.7, 0.2, -0.4, 0.3], [0.03, -0.05, 2.0], log_scales, 0.8, COLOUR);
        let loss = |probe: Option<&Tensor<2>>, camera: &Camera| {
            let (gaussians, colours) = gaussian.gaussians();
            (splat_probed(&gaussians, &colours, &limits, probe, camera, filter).unwrap() * weights.clone()).sum()
        };
        let probe = leaf(&[0.0; 2], [1, 2], &device());
        let of_probed = loss(Some(&probe), &camera);
        assert_eq!(values(&of_probed), values(&loss(None, &camera)));
        let found = values(&probe.grad(&of_probed.backward()).unwrap());
        let at = |x: f64, y: f64| values(&loss(None, &Camera { cx: camera.cx + x, cy: camera.cy + y, ..camera }))[0];
        let slopes = [at(STEP, 0.0) - at(-STEP, 0.0), at(0.0, STEP) - at(0.0, -STEP)].map(|rise| rise / (2.0 * STEP));
        let expected = [slopes[0] * 0.5 * camera.width as f64, slopes[1] * 0.5 * camera.height as f64];
        assert!(expected.iter().all(|slope| slope.abs() > 1e-3), "{expected:?}");
        for (found, expected) in found.iter().zip(expected) {
            approx::assert_relative_eq!(*found, expected, epsilon = 1e-6, max_relative = 1e-6);
        }
    }
}

#[test]
fn a_probe_of_another_shape_is_refused() {
    let camera = axis_camera();
    let limits = image(&random_limits(1, 2.0, &camera, 4), 2, &camera);
    let (gaussians, colours) = every_kind(7).gaussians();
    let error = splat_probed(&gaussians, &colours, &limits, Some(&colours), &camera, ScreenFilter::Plain).unwrap_err();
    assert_eq!(error.to_string(), "tensor `probe` has shape [7, 3], expected [7, 2]");
}
