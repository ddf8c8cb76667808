use super::gradients::check_gradients;
use super::*;
use crate::footprint::gaussian::cpu::student::Student;
use crate::math::CameraOf;

/// Students of every kind: with few and many degrees of freedom, of either sign, capped, a needle, one finer than a pixel,
/// one with its centre outside the image, and one behind the camera.
pub fn mixed() -> Flat {
    let mut flat = Flat::default();
    let mut push = |position, log_scales, opacity, degrees, colour| {
        flat.push(position, log_scales, opacity, colour);
        flat.1.push(degrees);
    };
    push([0.1, 0.0, 2.0], [-1.5, -1.55, -1.6], 0.999, 100.0, [0.9, 0.1, 0.2]);
    push([0.0, 0.1, 2.1], [-1.3, -1.6, -1.5], -0.9995, 3.5, [0.2, 0.8, 0.1]);
    push([0.2, 0.1, 3.0], [-0.7, -0.9, -0.4], 0.8, 1.0, [0.1, -0.2, 0.7]);
    push([-0.3, 0.0, 1.0], [-1.9, -2.1, -1.6], -0.4, 1.7, [0.3, 0.6, 0.9]);
    push([-0.1, 0.1, 2.5], [-0.7, -4.0, -5.0], 0.9, 12.4, [1.1, 0.4, 0.5]);
    push([-0.4, -0.2, 1.9], [-4.0, -4.2, -4.1], 0.95, 1e4, [0.7, 0.2, 0.4]);
    push([1.6, 0.9, 2.2], [-0.6, -0.3, -0.9], 0.9, 2.2, [0.5, 0.4, 0.2]);
    push([0.0, 0.0, -1.0], [-0.6, -0.3, -0.9], 0.9, 5.0, [0.5, 0.4, 0.2]);
    flat
}

/// Opacities of either sign and degrees of freedom from 1 to 1000.
fn random(seed: u64, gaussians: usize, size: [usize; 2]) -> (Flat, Camera) {
    let (mut flat, camera) = Flat::random(seed, gaussians, size);
    let count = flat.len();
    flat.0[3] = Random::new(seed + 1).numbers(count, -0.97, 0.97);
    flat.1 = Random::new(seed + 2).numbers(count, 0.0, 3.0).into_iter().map(|power| 10f64.powf(power)).collect();
    (flat, camera)
}

fn students(maps: bool) -> BlendOptions {
    BlendOptions { form: Form::Students, max_alpha: 0.99, maps, ..BlendOptions::default() }
}

#[test]
fn pictures_are_those_of_the_definition() {
    for (flat, camera) in [(mixed(), axis_camera()), random(71, 120, [61, 40])] {
        let options = students(true);
        let expected = images_of_pixels(&dense(&flat.primitives(&camera, &options), &camera, &options));
        let found = images(&flat.leaves().blend(&camera, &options));
        for (output, (found, expected)) in found.iter().zip(&expected).enumerate() {
            assert!(relative_l2(found, expected) < 1e-11, "output {output}: {:.1e}", relative_l2(found, expected));
        }
        let alpha = &found[1];
        assert!(alpha.iter().any(|&alpha| alpha < -0.05) && alpha.iter().any(|&alpha| alpha > 0.05));
    }
}

#[test]
fn gradients_of_every_output_are_central_differences() {
    for (flat, camera) in [(mixed(), axis_camera()), random(31, 9, [29, 21])] {
        let options = students(true);
        check_gradients(&flat, &camera, &options, &OUTPUTS, 1e-6);
        // of whole numbers the reach jumps, and 1 is the least: neither counts, since α is below the cutoff there
        let inner: Vec<f64> = flat.1.iter().map(|&degrees| degrees.max(1.0 + 1e-5)).collect();
        for output in OUTPUTS {
            let loss = |degrees: &[f64]| {
                let leaves = Flat(flat.0.clone(), degrees.to_vec()).leaves();
                let loss = leaves.loss(&[output], &camera, &options);
                (leaves.gaussians.degrees_of_freedom.unwrap(), loss)
            };
            let of = |degrees: &[f64]| {
                let (leaf, loss) = loss(degrees);
                gradient_of(&leaf, &loss.backward())
            };
            check(&format!("{output:?} with respect to degrees of freedom"), &inner, &of(&inner), 1e-6, |moved| {
                values(&loss(moved).1)[0]
            });
            assert!(of(&flat.1).iter().any(|&gradient| gradient != 0.0));
        }
    }
}

#[test]
fn kernels_with_less_than_one_degree_of_freedom_do_not_exist() {
    let camera = CameraOf::<f64>::new(&axis_camera());
    let exists = |degrees_of_freedom: f64| {
        let parameters = Parameters { degrees_of_freedom, ..mixed().parameters(0) };
        Student::new(&camera, &parameters, [0.0; 3]).is_some()
    };
    assert!(exists(1.0) && !exists(0.9));
}

#[test]
fn single_precision_is_near_the_definition() {
    for (flat, camera) in [(mixed(), axis_camera()), random(73, 120, [61, 40])] {
        let exact = images(&flat.leaves().blend(&camera, &students(false)));
        let single = images(&flat.leaves_on(&device(), DType::F32).blend(&camera, &students(false)));
        for (found, expected) in single.iter().zip(&exact) {
            assert!(relative_l2(found, expected) < 2e-5, "{:.1e}", relative_l2(found, expected));
        }
    }
}

#[test]
fn degrees_of_freedom_belong_to_students_alone() {
    let (students_flat, camera) = (mixed(), axis_camera());
    let refused = |flat: &Flat, options: &BlendOptions| {
        let leaves = flat.leaves();
        blend(&leaves.gaussians, &leaves.colours, None, &camera, options).unwrap_err().to_string()
    };
    assert!(refused(&students_flat, &with_maps(Form::Ellipsoids)).contains("option `form` is Ellipsoids with them"));
    assert!(refused(&capped(), &students(false)).contains("option `form` is Students without them"));
}
