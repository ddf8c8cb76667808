//! Peeling through lenses of every kind.

use super::*;
use crate::ops::fixtures::cameras_with_lenses;
use crate::testing::lenses::behind;

#[test]
fn no_fragment_lies_outside_the_reach_of_its_disc() {
    let options = options(1, 30.0, Footprint::Kernel);
    for (name, camera) in cameras_with_lenses(axis_camera(40, 30)) {
        let fragments: usize = fragments_within_reach(name, &camera, &options, 600).iter().sum();
        assert!(fragments > 1000, "{name}: {fragments}");
    }
}

#[test]
fn peeling_equals_sorting_all_fragments() {
    for (name, camera) in cameras_with_lenses(axis_camera(37, 22)) {
        let mut surfels = every_kind(240);
        // edge-on discs magnify rounding, which may then decide
        surfels = surfels.into_iter().enumerate().filter(|(i, _)| i % 6 != 3).map(|(_, surfel)| surfel).collect();
        let surfels = Flat::of(&surfels);
        let options = options(4, 30.0, Footprint::Kernel);
        let (layers, expected) = (surfels.peel(&camera, &options), surfels.peel_densely(&camera, &options));
        let ids = ids_of(&layers);
        let wanted: Vec<i64> = expected.iter().map(|f| f.map_or(-1, |f| f.1 as i64)).collect();
        let apart = ids.iter().zip(&wanted).filter(|(a, b)| a != b).count();
        assert_eq!(apart, 0, "{name}: {apart} of {} layers are others", ids.len());
        assert!(wanted.iter().filter(|&&id| id >= 0).count() > ids.len() / 8, "{name}");
    }
}

/// Surfels all over the picture, up to its corners.
fn all_over(camera: &Camera, seed: u64, count: usize) -> Flat {
    let mut random = Random::new(seed);
    let surfels: Vec<Parameters> = (0..count)
        .map(|_| {
            let (x, y) = (random.between(0.0, camera.width as f64), random.between(0.0, camera.height as f64));
            let distance = random.between(1.0, 3.0);
            Parameters {
                position: camera.unproject(x, y, distance).to_array(),
                quaternion: std::array::from_fn(|_| random.normal()),
                log_scales: std::array::from_fn(|_| (distance * random.between(0.1, 0.4)).ln()),
            }
        })
        .collect();
    Flat::of(&surfels)
}

#[test]
fn gradients_of_alpha_and_depth_are_central_differences() {
    for (seed, (name, camera)) in (40..).zip(cameras_with_lenses(axis_camera(21, 18))) {
        let surfels = all_over(&camera, seed, 7);
        check_gradients(name, &surfels, &camera, &options(3, 0.8, Footprint::Opacity), seed);
    }
}

/// A lens without distortion is a pinhole.
#[test]
fn a_straight_lens_shows_what_a_pinhole_shows() {
    let straight = crate::camera::Distortion::new(crate::camera::Projection::Perspective);
    let pinhole = axis_camera(40, 30);
    let camera = behind(pinhole, straight, 90.0);
    let (surfels, options) = (Flat::of(&every_kind(120)), options(3, 0.8, Footprint::Opacity));
    let (found, expected) = (surfels.peel(&camera, &options), surfels.peel(&pinhole, &options));
    let apart = |a: &Tensor<3>, b: &Tensor<3>| {
        values(a).iter().zip(values(b)).filter(|(a, b)| (*a - b).abs() > 1e-6 * b.abs()).count()
    };
    assert!(apart(&found.alpha, &expected.alpha) <= 4 && apart(&found.depth, &expected.depth) <= 4);
}
