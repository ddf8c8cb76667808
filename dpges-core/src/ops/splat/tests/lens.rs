//! Splatting through lenses of every kind.

use super::*;
use crate::ops::fixtures::cameras_with_lenses;

/// Gaussians all over the picture of a camera, up to its corners and a little beyond.
fn all_over(camera: &Camera, seed: u64, count: usize) -> Flat {
    let (mut random, mut flat) = (Random::new(seed), Flat::default());
    for _ in 0..count {
        let across = |random: &mut Random, size: usize| random.between(-0.05, 1.05) * size as f64;
        let (x, y) = (across(&mut random, camera.width), across(&mut random, camera.height));
        let distance = random.between(1.0, 3.0);
        let scales = std::array::from_fn(|_| (distance * random.between(0.03, 0.25)).ln());
        let position = camera.unproject(x, y, distance).to_array();
        let quaternion = std::array::from_fn(|_| random.normal());
        flat.push_turned(quaternion, position, scales, random.between(0.2, 1.2), COLOUR);
    }
    flat
}

#[test]
fn tiled_sums_and_contributions_equal_dense_ones() {
    for (seed, (name, camera)) in (60..).zip(cameras_with_lenses(axis_camera())) {
        check_against_dense(name, &all_over(&camera, seed, 80), 3, 2.0, &camera, 1e-10);
    }
}

#[test]
fn gradients_of_the_sums_are_central_differences() {
    for (seed, (name, camera)) in (70..).zip(cameras_with_lenses(axis_camera())) {
        check_gradients(name, &all_over(&camera, seed, 8), &camera);
    }
}

/// The ellipse of a small Gaussian lies where the lens shows the Gaussian, and has the shape that the lens gives it.
#[test]
fn a_small_gaussian_looks_like_the_points_of_its_ellipsoid() {
    for (name, camera) in cameras_with_lenses(axis_camera()) {
        let large = camera.resized(40 * 64, 30 * 64);
        for (x, y) in [(0.1, 0.2), (0.5, 0.5), (0.9, 0.8)] {
            let (x, y) = (x * large.width as f64, y * large.height as f64);
            let position = large.unproject(x, y, 2.0);
            let scales = [0.004, 0.002, 0.003];
            let q = glam::DQuat::from_xyzw(0.2, -0.4, 0.1, 0.8).normalize();
            let parameters = Parameters {
                position: position.to_array(),
                quaternion: [q.w, q.x, q.y, q.z],
                log_scales: scales.map(f64::ln),
                opacity: 1.0,
                degrees_of_freedom: f64::INFINITY,
            };
            let splat = Splat::new(&CameraOf::<f64>::new(&large), &parameters, [1.0; 3], ScreenFilter::Compensated);
            let splat = splat.unwrap_or_else(|| panic!("{name}: not seen at ({x}, {y})"));
            assert!((splat.mean[0] - x).abs() < 1e-6 && (splat.mean[1] - y).abs() < 1e-6, "{name}: {:?}", splat.mean);
            // the covariance of the ends of its axes, seen one by one
            let mut covariance = [0.0; 3];
            for (axis, scale) in DVec3::AXES.into_iter().zip(scales) {
                let end = q * (axis * scale);
                let ((ax, ay, _), (bx, by, _)) =
                    (large.project(position + end).unwrap(), large.project(position - end).unwrap());
                let (dx, dy) = (0.5 * (ax - bx), 0.5 * (ay - by));
                covariance = [covariance[0] + dx * dx, covariance[1] + dx * dy, covariance[2] + dy * dy];
            }
            let [p, q, r] = splat.root;
            let determinant = 1.0 / (p * r).powi(2);
            let found = [(q * q + r * r) * determinant, -p * q * determinant, p * p * determinant];
            let low_pass = ScreenFilter::Compensated.variance();
            let expected = [covariance[0] + low_pass, covariance[1], covariance[2] + low_pass];
            let size = expected[0].max(expected[2]);
            for i in 0..3 {
                assert!((found[i] - expected[i]).abs() < 2e-3 * size, "{name}: {found:?}, expected {expected:?}");
            }
        }
    }
}
