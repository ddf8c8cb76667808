use super::gradients::{check_gradients, check_outputs};
use super::*;

/// Two long ellipsoids that cross on the axis, one a little nearer at its centre, and a sheet behind them.
pub fn crossed() -> Flat {
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
    let (random, random_camera) =
        Flat::random(31, &Recipe { surfels: 0, gaussians: 9, width: 29, height: 21, ..Recipe::default() });
    for (flat, camera) in [(capped(), camera), (crossed(), camera), (random, random_camera)] {
        let found = images(&flat.leaves().blend(&camera, &by_rays()));
        let expected = images_of_pixels(&dense(&flat.primitives(&camera, &by_rays()), &camera, &by_rays()));
        for (found, expected) in found.iter().zip(&expected) {
            assert!(relative_l2(found, expected) < 1e-12);
        }
    }
}

/// Whether the first of [`crossed`] shows more than the second, on either side of the axis.
pub fn redder_on_sides(options: &BlendOptions) -> [bool; 2] {
    let camera = axis_camera();
    let colours = images(&crossed().leaves().blend(&camera, options))[0].clone();
    [10, 26].map(|column| {
        let at = 14 * camera.width + column;
        colours[at] > colours[camera.width * camera.height + at]
    })
}

#[test]
fn what_crosses_is_in_front_on_its_side() {
    assert_eq!(redder_on_sides(&BlendOptions { order: BlendOrder::Centres, ..by_rays() }), [true; 2]);
    let [left, right] = redder_on_sides(&by_rays());
    assert!(left != right);
}

#[test]
fn gradients_in_the_order_of_rays_are_central_differences() {
    check_outputs(&capped(), &by_rays());
    check_gradients(&crossed(), &axis_camera(), &by_rays(), &OUTPUTS, 1e-6);
}

#[test]
fn gradients_of_full_queues_are_central_differences() {
    // more fragments in a pixel than it holds, and more in a block
    let recipe = Recipe { surfels: 0, gaussians: 90, width: 6, height: 5, ..Recipe::default() };
    let (mut flat, camera) = Flat::random(32, &recipe);
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

/// Differences between successive pictures of a camera that turns on the spot: the largest over the median.
fn spike_of_a_turn(flat: &Flat, order: BlendOrder) -> f64 {
    const STEP: f64 = 2e-4;
    let (options, leaves, camera) = (BlendOptions { order, maps: false, ..by_rays() }, flat.leaves(), axis_camera());
    let picture = |step: i32| {
        let turn = DVec3::new(0.0, STEP * f64::from(step), 0.0);
        let camera_from_world = camera.camera_from_world.moved(turn, DVec3::ZERO);
        values(&leaves.blend(&Camera { camera_from_world, ..camera }, &options).colour)
    };
    let pictures: Vec<Vec<f64>> = (-20..20).map(picture).collect();
    let difference = |pair: &[Vec<f64>]| pair[0].iter().zip(&pair[1]).map(|(a, b)| (a - b).abs()).sum::<f64>();
    let mut differences: Vec<f64> = pictures.windows(2).map(difference).collect();
    differences.sort_by(f64::total_cmp);
    differences[differences.len() - 1] / differences[differences.len() / 2]
}

#[test]
fn nothing_pops_when_the_camera_turns() {
    let mut flat = Flat::default();
    // side by side: a turn by 0.001 rad has the other one nearer, by the depths of their centres
    flat.push([-0.3, -0.2, 1.9997], [-1.2; 3], 0.9, [0.9, 0.1, 0.2]);
    flat.push([0.3, 0.2, 2.0003], [-1.2; 3], 0.9, [0.1, 0.8, 0.3]);
    let (by_centres, by_rays) = (spike_of_a_turn(&flat, BlendOrder::Centres), spike_of_a_turn(&flat, BlendOrder::Rays));
    assert!(by_centres > 8.0 && by_rays < 2.0, "{by_centres} by centres, {by_rays} by rays");
}
