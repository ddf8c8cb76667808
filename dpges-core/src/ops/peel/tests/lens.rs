//! Peeling through lenses of every kind.

use super::*;
use crate::testing::lenses::{behind, every_model};

/// Cameras with a lens of every model; wide ones see 170° across their picture, and more in its corners.
fn cameras(width: usize, height: usize) -> Vec<(&'static str, Camera)> {
    every_model().into_iter().map(|(name, lens)| (name, behind(axis_camera(width, height), lens, 170.0))).collect()
}

#[test]
fn no_fragment_lies_outside_the_reach_of_its_disc() {
    let options = options(1, 30.0, Footprint::Kernel);
    let radius = options.footprint.radius(options.modulation).unwrap();
    for (name, camera) in cameras(40, 30) {
        let of = CameraOf::new(&camera);
        let mut fragments = 0;
        for (i, surfel) in every_kind(600).iter().enumerate() {
            let rect = Disc::new(&of, surfel).reach(&of, radius);
            let dense = Dense::new(&of, surfel);
            for (x, y) in (0..30).flat_map(|y| (0..40).map(move |x| (x, y))) {
                if dense.fragment(&of, &options, f64::from(x) + 0.5, f64::from(y) + 0.5).is_some() {
                    fragments += 1;
                    let inside = (rect.x0..rect.x1).contains(&x) && (rect.y0..rect.y1).contains(&y);
                    assert!(inside, "{name}: pixel ({x}, {y}) of surfel {i} {surfel:?} is outside {rect:?}");
                }
            }
        }
        assert!(fragments > 1000, "{name}: {fragments}");
    }
}

#[test]
fn peeling_equals_sorting_all_fragments() {
    for (name, camera) in cameras(37, 22) {
        let mut surfels = every_kind(240);
        // edge-on discs magnify rounding, which may then decide
        surfels = surfels.into_iter().enumerate().filter(|(i, _)| i % 6 != 3).map(|(_, surfel)| surfel).collect();
        let surfels = Flat::of(&surfels);
        let options = options(4, 30.0, Footprint::Kernel);
        let (layers, expected) = (surfels.peel(&camera, &options), surfels.peel_densely(&camera, &options));
        let ids: Vec<i64> = layers.ids.into_data().iter::<i64>().collect();
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
    for (seed, (name, camera)) in (40..).zip(cameras(21, 18)) {
        let surfels = all_over(&camera, seed, 7);
        let options = options(3, 0.8, Footprint::Opacity);
        let shape = [3, camera.height, camera.width];
        let weights = leaf(&Random::new(seed).numbers(shape.iter().product(), -1.0, 1.0), shape, &device()).detach();
        for of in [PeelGradient::Alpha, PeelGradient::Depth] {
            let leaves = surfels.leaves();
            let [positions, quaternions, log_scales] = &leaves;
            let layers = peel(positions, quaternions, log_scales, &camera, &options).unwrap();
            let gradients = loss(&layers, of, &weights).backward();
            for (i, leaf) in leaves.iter().enumerate() {
                let found = leaf.grad(&gradients).map_or_else(|| vec![0.0; surfels.0[i].len()], |g| values(&g));
                let name = format!("{name}: {of:?} by {}", ["positions", "quaternions", "log_scales"][i]);
                check(&name, &surfels.0[i], &found, 1e-6, |moved| {
                    let mut surfels = surfels.clone();
                    surfels.0[i] = moved.to_vec();
                    values(&loss(&surfels.peel(&camera, &options), of, &weights))[0]
                });
            }
        }
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
