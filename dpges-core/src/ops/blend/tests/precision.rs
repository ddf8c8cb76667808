use super::*;

/// Compares some outputs in f32 and their gradients with those in f64.
pub fn check_single(
    flat: &Flat,
    camera: &Camera,
    options: &BlendOptions,
    outputs: &[Output],
    [of_output, of_gradient]: [f64; 2],
) {
    let all = [flat.leaves_on(&device(), DType::F32), flat.leaves()];
    let name = format!("{:?} by {}", options.form, options.order);
    let [found, expected] = all.each_ref().map(|leaves| leaves.blend(camera, options));
    for output in outputs {
        let distance = relative_l2(&values(output.of(&found)), &values(output.of(&expected)));
        assert!(distance < of_output, "{output:?} of {name}: {distance:e}");
    }
    let [found, expected] = all.each_ref().map(|leaves| leaves.gradients(outputs, camera, options));
    for (attribute, (found, expected)) in NAMES.iter().zip(found.iter().zip(&expected)) {
        let distance = relative_l2(found, expected);
        assert!(distance < of_gradient, "{name} with respect to {attribute}: {distance:e}");
    }
}

#[test]
fn single_precision_is_close_to_double() {
    let (flat, camera) = Flat::random(14, 300, [61, 40]);
    // z of a hit has no bound where a disc is seen edge-on
    let bounded: &[Output] = &[Output::Colour, Output::Alpha, Output::Normal];
    for (form, outputs) in [(Form::Ellipsoids, OUTPUTS.as_slice()), (Form::Discs, bounded)] {
        check_single(&flat, &camera, &with_maps(form), outputs, [1e-4, 1e-2]);
    }
}

#[test]
fn single_precision_tells_near_surfaces_apart_far_behind_the_near_plane() {
    let camera = Camera { near: 0.01, ..axis_camera() };
    let mut flat = Flat::default();
    flat.push([0.0, 0.0, 4.0], [0.5, 0.6, 0.4], 0.5, [0.5; 3]);
    flat.push([0.0, 0.0, 4.05], [0.5, 0.4, 0.6], 0.5, [0.5; 3]);
    let options = with_maps(Form::Ellipsoids);
    let [found, expected] = [DType::F32, DType::F64].map(|dtype| {
        let blended = flat.leaves_on(&device(), dtype).blend(&camera, &options);
        values(Output::Distortion.of(&blended))
    });
    assert!(expected[BESIDE_AXIS] > 0.0 && expected[BESIDE_AXIS] < 1e-9);
    assert!(relative_l2(&found, &expected) < 1e-3);
}

#[cfg(all(feature = "ndarray", feature = "flex"))]
#[test]
fn both_cpu_backends_agree_to_the_bit() {
    let (flat, camera) = Flat::random(15, 300, [61, 40]);
    for (dtype, options) in
        [DType::F32, DType::F64].into_iter().flat_map(|dtype| every_way().map(|options| (dtype, options)))
    {
        let [ndarray, flex] =
            [Device::ndarray(), Device::flex()].map(|device| flat.leaves_on(&device.autodiff(), dtype));
        assert_eq!(images(&ndarray.blend(&camera, &options)), images(&flex.blend(&camera, &options)));
        let [ndarray, flex] = [ndarray, flex].map(|leaves| leaves.gradients(&OUTPUTS, &camera, &options));
        assert_eq!(ndarray, flex);
    }
}
