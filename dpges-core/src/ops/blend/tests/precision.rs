use super::*;

#[test]
fn single_precision_is_close_to_double() {
    let recipe = Recipe { surfels: 0, gaussians: 300, width: 61, height: 40, ..Recipe::default() };
    let (flat, camera) = Flat::random(14, &recipe);
    let (single, double) = (flat.leaves_on(&device(), DType::F32), flat.leaves());
    // z of a hit has no bound where a disc is seen edge-on
    let bounded: &[Output] = &[Output::Colour, Output::Alpha, Output::Normal];
    for (form, outputs) in [(Form::Ellipsoids, OUTPUTS.as_slice()), (Form::Discs, bounded)] {
        let options = with_maps(form);
        let [found, expected] = [&single, &double].map(|leaves| leaves.blend(&camera, &options));
        for output in outputs {
            let distance = relative_l2(&values(output.of(&found)), &values(output.of(&expected)));
            assert!(distance < 1e-4, "{output:?} of {form:?}: {distance:e}");
        }
        let [found, expected] = [&single, &double].map(|leaves| leaves.gradients(outputs, &camera, &options));
        for (name, (found, expected)) in NAMES.iter().zip(found.iter().zip(&expected)) {
            let distance = relative_l2(found, expected);
            assert!(distance < 1e-2, "{form:?} with respect to {name}: {distance:e}");
        }
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
    let recipe = Recipe { surfels: 0, gaussians: 300, width: 61, height: 40, ..Recipe::default() };
    let (flat, camera) = Flat::random(15, &recipe);
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
