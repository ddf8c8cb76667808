use super::gradients::{check_gradients, check_outputs};
use super::*;

/// Two long ellipsoids that cross on the axis, one a little nearer at its centre, and a sheet behind them.
fn crossed() -> Flat {
    let mut flat = Flat::default();
    let turned = |half: f64| [half.cos(), 0.0, half.sin(), 0.0];
    flat.push_turned(turned(0.3), [0.0, 0.0, 2.0], [-0.6, -2.5, -3.5], 0.9, [0.9, 0.1, 0.2]);
    flat.push_turned(turned(-0.3), [0.0, 0.0, 2.02], [-0.6, -2.5, -3.5], 0.9, [0.1, 0.8, 0.3]);
    flat.push_turned(turned(0.0), [0.1, 0.1, 2.4], [-0.2, -0.4, -4.0], 0.7, [0.2, 0.3, 0.9]);
    flat
}

#[test]
fn few_fragments_are_blended_in_the_order_along_their_ray() {
    let camera = axis_camera();
    let (random, random_camera) = Flat::random(31, 9, [29, 21]);
    for (flat, camera) in [(capped(), camera), (crossed(), camera), (random, random_camera)] {
        let found = images(&flat.leaves().blend(&camera, &by_rays()));
        let expected = images_of_pixels(&dense(&flat.primitives(&camera, &by_rays()), &camera, &by_rays()));
        for (found, expected) in found.iter().zip(&expected) {
            assert!(relative_l2(found, expected) < 1e-12);
        }
    }
}

#[test]
fn gradients_in_the_order_of_rays_are_central_differences() {
    check_outputs(&capped(), &by_rays());
    check_gradients(&crossed(), &axis_camera(), &by_rays(), &OUTPUTS, 1e-6);
}

#[test]
fn gradients_of_full_queues_are_central_differences() {
    // more fragments in a pixel than it holds, and more in a block
    let (mut flat, camera) = Flat::random(32, 90, [6, 5]);
    let rows = flat.len();
    flat.0[2] = (0..rows).flat_map(|i| [-0.9 + 0.01 * (i % 7) as f64, -1.8, -2.5 + 0.1 * (i % 5) as f64]).collect();
    flat.0[3] = (0..rows).map(|i| 0.05 + 0.001 * i as f64).collect();
    let fewest = flat.primitives(&camera, &by_rays()).len();
    assert!(fewest > crate::ops::blend::QUEUES[0], "{fewest}");
    check_gradients(&flat, &camera, &by_rays(), &[Output::Colour, Output::Depth], 1e-7);
}

#[test]
fn what_is_met_behind_the_camera_does_not_exist() {
    let camera = axis_camera();
    let shown = |depth: f64, order: BlendOrder| {
        let mut flat = Flat::default();
        // a long ellipsoid beside the camera that points behind it
        flat.push_turned([0.9, 0.0, 0.44, 0.0], [1.5, 0.0, depth], [-2.0, -1.5, 0.8], 0.9, [1.0; 3]);
        let alpha = &images(&flat.leaves().blend(&camera, &BlendOptions { order, ..by_rays() }))[1];
        alpha.iter().filter(|alpha| **alpha > 0.0).count()
    };
    assert!(shown(3.0, BlendOrder::Rays) > 0);
    let (near, everywhere) = (shown(0.3, BlendOrder::Rays), shown(0.3, BlendOrder::Centres));
    assert!(near < everywhere, "{near} of {everywhere}");
}
