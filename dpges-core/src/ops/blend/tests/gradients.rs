use super::*;

/// Checks the gradients of each of some outputs, of the parameters one after the other.
pub fn check_gradients(flat: &Flat, camera: &Camera, options: &BlendOptions, outputs: &[Output], step: f64) {
    let leaves = flat.leaves();
    for output in outputs {
        let found = leaves.gradients(&[*output], camera, options);
        assert!(found[0].iter().any(|g| *g != 0.0));
        for (of, parameters) in flat.0.iter().enumerate() {
            let name = format!("{output:?} of {:?} by {} with respect to {}", options.form, options.order, NAMES[of]);
            check(&name, parameters, &found[of], step, |moved| {
                let flat = Flat(replaced(&flat.0, of, moved), flat.1.clone());
                values(&flat.leaves().loss(&[*output], camera, options))[0]
            });
        }
    }
}

/// Checks the gradients of every output of some random Gaussians and of a scene.
pub fn check_outputs(scene: &Flat, options: &BlendOptions) {
    let (random, random_camera) = Flat::random(31, 9, [29, 21]);
    check_gradients(&random, &random_camera, options, &OUTPUTS, 1e-6);
    check_gradients(scene, &axis_camera(), options, &OUTPUTS, 1e-6);
}

#[test]
fn gradients_of_every_output_of_ellipsoids_are_central_differences() {
    for options in [with_maps(Form::Ellipsoids), plainly_filtered()] {
        check_outputs(&capped(), &options);
    }
}

#[test]
fn gradients_of_every_output_of_discs_are_central_differences() {
    check_outputs(&slanted(), &with_maps(Form::Discs));
}

#[test]
fn gradients_are_central_differences_in_more_tiles_than_are_summed_at_a_time() {
    let camera = axis_camera().resized(140, 120);
    for options in [with_maps(Form::Ellipsoids), by_rays()] {
        check_gradients(&capped(), &camera, &options, &[Output::Colour], 1e-7);
    }
}

#[test]
fn maps_do_not_change_the_gradient_of_colour() {
    let (flat, camera) = Flat::random(16, 100, [61, 40]);
    let leaves = flat.leaves();
    for way in every_way() {
        let [without, with] = [false, true].map(|maps| {
            let options = BlendOptions { maps, ..way };
            leaves.gradients(&[Output::Colour, Output::Alpha], &camera, &options)
        });
        assert_eq!(without, with);
    }
}
