use super::*;

/// The terms of the probe's gradient, from central differences at every pixel: of the weighted sum of all planes with
/// respect to the projected centre.
fn brute_force_probe(flat: &Flat, camera: &Camera, options: &BlendOptions) -> Vec<f64> {
    const STEP: f64 = 1e-6;
    let pixels = camera.width * camera.height;
    let weights: Vec<f64> = OUTPUTS.iter().flat_map(|output| output.weights(pixels)).collect();
    let mut primitives = flat.primitives(camera, options);
    let mut sums = vec![0.0; 4 * flat.len()];
    for k in 0..primitives.len() {
        let Primitive { row, shape, .. } = primitives[k];
        for (i, axis) in (0..pixels).flat_map(|i| [(i, 0), (i, 1)]) {
            let at = centre_of(camera, i);
            if shape.is_filtered(at) {
                continue;
            }
            let mut moved = |by: f64| {
                match &mut primitives[k].shape {
                    Shape::Ellipse(splat) | Shape::Student { splat, .. } => splat.mean[axis] += by,
                    Shape::Disc { rows, .. } => rows[axis][2] += by,
                    Shape::Whitened { .. } => unreachable!("its probe is another"),
                }
                let planes = pixel(&primitives, camera, options, at).planes;
                primitives[k].shape = shape;
                planes.iter().enumerate().map(|(plane, value)| weights[plane * pixels + i] * value).sum::<f64>()
            };
            let slope = (moved(STEP) - moved(-STEP)) / (2.0 * STEP);
            let per_centre = match shape {
                Shape::Ellipse(_) | Shape::Student { .. } | Shape::Whitened { .. } => 1.0,
                Shape::Disc { rows, .. } => rows[2][2],
            };
            let gradient = slope * per_centre * 0.5 * [camera.width, camera.height][axis] as f64;
            sums[4 * row + axis] += gradient;
            sums[4 * row + 2 + axis] += gradient.abs();
        }
    }
    sums
}

/// Returns the largest number.
pub fn assert_same_probe(found: &[f64], expected: &[f64]) -> f64 {
    let largest = expected.iter().fold(0.0, |m: f64, v| m.max(v.abs()));
    for (a, b) in found.iter().zip(expected) {
        approx::assert_relative_eq!(*a, *b, epsilon = 1e-6 * largest, max_relative = 1e-5);
    }
    largest
}

#[test]
fn the_probe_collects_what_every_pixel_wants_of_the_projected_centre() {
    let camera = axis_camera();
    for options in [with_maps(Form::Ellipsoids), with_maps(Form::Discs), by_rays(), with_maps(Form::Students)] {
        let flat = scene_of(options.form);
        let expected = brute_force_probe(&flat, &camera, &options);
        let found = flat.leaves().gradients(&OUTPUTS, &camera, &options);
        assert!(assert_same_probe(&found[5], &expected) > 1.0);
    }
}

#[test]
fn no_value_depends_on_the_probe() {
    let (leaves, camera) = (capped().leaves(), axis_camera());
    for options in every_way() {
        let with = |probe: Option<Tensor<2>>| {
            images(&blend(&leaves.gaussians, &leaves.colours, probe.as_ref(), &camera, &options).unwrap())
        };
        assert_eq!(with(None), with(Some(leaves.probe.clone() + 1.0)));
    }
}

#[test]
fn a_probe_of_another_shape_is_refused() {
    let leaves = capped().leaves();
    let (colours, camera) = (&leaves.colours, axis_camera());
    let error = blend(&leaves.gaussians, colours, Some(colours), &camera, &BlendOptions::default()).unwrap_err();
    assert_eq!(error.to_string(), "tensor `probe` has shape [7, 3], expected [7, 4]");
}
