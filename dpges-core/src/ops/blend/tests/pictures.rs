use super::*;

#[test]
fn blending_equals_sorting_at_every_pixel() {
    let mut round = capped();
    round.push([0.2, -0.1, 1.5], [-1.7; 3], 0.3, [0.4, 0.4, 0.9]);
    let mut scenes = vec![(round.clone(), axis_camera()), (round.reversed(), axis_camera())];
    scenes.push((slanted(), axis_camera()));
    for (seed, gaussians) in [(1, 40), (2, 400), (3, 1000)] {
        scenes.push(Flat::random(seed, gaussians, [45, 37]));
    }
    let options = [(with_maps(Form::Ellipsoids), 1e-11), (plainly_filtered(), 1e-11), (with_maps(Form::Discs), 1e-9)];
    for (options, tolerance) in options {
        for (flat, camera) in &scenes {
            check_pictures(flat, camera, &options, tolerance, 0);
        }
    }
}

#[test]
fn the_plain_filter_widens_and_does_not_dim() {
    let camera = axis_camera();
    // on the axis at depth 2, thin: 20 px × 0.1 σ across the screen
    let (mut flat, opacity, colour) = (Flat::default(), 0.7, [1.0, 0.5, 0.0]);
    flat.push([0.0, 0.0, 2.0], [-4.0, -2.0, -3.0], opacity, colour);
    flat.0[1] = vec![1.0, 0.0, 0.0, 0.0];
    let alpha = images(&flat.leaves().blend(&camera, &plainly_filtered()))[1].clone();
    let variance = |log_scale: f64, focal: f64| (focal / 2.0 * log_scale.exp()).powi(2) + 0.3;
    let (across, down) = (variance(-4.0, camera.fx), variance(-2.0, camera.fy));
    for (i, found) in alpha.iter().enumerate() {
        let [x, y] = centre_of(&camera, i);
        let (dx, dy) = (x - camera.cx, y - camera.cy);
        let expected = opacity * (-0.5 * (dx * dx / across + dy * dy / down)).exp();
        let expected = if expected < 1.0 / 255.0 { 0.0 } else { expected };
        assert!((found - expected).abs() < 1e-12, "({x}, {y}): {found}, expected {expected}");
    }
    assert!(alpha.iter().filter(|alpha| **alpha > 0.0).count() > 20);
}

#[test]
fn the_slanted_discs_have_both_kinds_of_hits_and_of_low_pass_filters() {
    let camera = axis_camera();
    let discs = slanted().primitives(&camera, &with_maps(Form::Discs));
    let unfiltered = |disc: &Primitive| matches!(disc.shape, Shape::Disc { low_pass: None, .. });
    assert_eq!(discs.iter().filter(|disc| unfiltered(disc)).count(), 1);
    let filtered = |disc: &Primitive| (0..1200).filter(|&i| disc.shape.is_filtered(centre_of(&camera, i))).count();
    assert!(discs.iter().any(|disc| filtered(disc) > 1000));
    assert!(discs.iter().any(|disc| (1..1000).contains(&filtered(disc))));
}

#[test]
fn nothing_blends_to_nothing() {
    let camera = axis_camera();
    let mut unseen = Flat::default();
    unseen.push([0.0, 0.0, -2.0], [-1.0; 3], 1.0, [1.0; 3]);
    unseen.push([0.0, 0.0, 2.0], [-1.0; 3], 0.0, [1.0; 3]);
    for (flat, options) in [Flat::default(), unseen].iter().flat_map(|flat| every_way().map(|way| (flat, way))) {
        let leaves = flat.leaves();
        let blended = leaves.blend(&camera, &options);
        assert_eq!(blended.colour.dims(), [3, 30, 40]);
        assert_eq!(blended.maps.as_ref().unwrap().median_depth.dims(), [1, 30, 40]);
        assert!(images(&blended).iter().flatten().all(|v| *v == 0.0));
        let gradients = leaves.gradients(&OUTPUTS, &camera, &options);
        for (gradient, width) in gradients.iter().zip(WIDTHS) {
            assert_eq!(gradient.len(), flat.len() * width);
            assert!(gradient.iter().all(|g| *g == 0.0));
        }
    }
}

#[test]
fn ties_in_depth_are_broken_by_index() {
    let camera = axis_camera();
    let (red, green) = ([1.0, 0.0, 0.0], [0.0, 1.0, 0.0]);
    for form in FORMS {
        let red_share = |first: [f64; 3], second: [f64; 3]| {
            let mut flat = Flat::default();
            flat.push([0.0, 0.0, 2.0], [0.0; 3], 0.6, first);
            flat.push([0.0, 0.0, 2.0], [0.0; 3], 0.6, second);
            images(&flat.leaves().blend(&camera, &with_maps(form)))[0][BESIDE_AXIS]
        };
        assert!(red_share(red, green) > 0.55);
        assert!(red_share(green, red) < 0.3);
    }
}

#[test]
fn the_order_of_the_parameters_does_not_matter() {
    let (flat, camera) = Flat::random(12, 300, [61, 40]);
    let (leaves, backwards) = (flat.leaves(), flat.reversed().leaves());
    for options in every_way() {
        assert_eq!(images(&leaves.blend(&camera, &options)), images(&backwards.blend(&camera, &options)));
        let found = backwards.gradients(&OUTPUTS, &camera, &options);
        let expected = leaves.gradients(&OUTPUTS, &camera, &options);
        for ((found, expected), width) in found.iter().zip(&expected).zip(WIDTHS) {
            assert_eq!(&reversed(found, width), expected);
        }
    }
}

#[test]
fn the_number_of_threads_does_not_matter() {
    let (flat, camera) = Flat::random(13, 200, [170, 150]);
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let leaves = flat.leaves_on(&device(), DType::F32);
            every_way().map(|options| {
                (images(&leaves.blend(&camera, &options)), leaves.gradients(&OUTPUTS, &camera, &options))
            })
        })
    };
    let alone = on(1);
    assert_eq!(alone, on(2));
    assert_eq!(alone, on(5));
}

#[test]
fn options_outside_their_range_are_refused() {
    let leaves = capped().leaves();
    let default = BlendOptions::default();
    let of_order = |form: Form| BlendOptions { form, ..by_rays() };
    let cases = [
        (BlendOptions { max_alpha: 1.0, ..default }, "`max_alpha` is 1, expected a number above 0 and at most 0.9999"),
        (
            BlendOptions { min_transmittance: 0.0, ..default },
            "`min_transmittance` is 0, expected a number between 0 and 1",
        ),
        (of_order(Form::Discs), "`order` is rays, expected centres for discs"),
        (of_order(Form::Students), "`order` is rays, expected centres for Student's t kernels"),
        (of_order(Form::Whitened), "`order` is rays, expected hybrid, nearest, sorted or tail for whitened Gaussians"),
    ];
    for (options, expected) in cases {
        let error = blend(&leaves.gaussians, &leaves.colours, None, &axis_camera(), &options).unwrap_err();
        assert_eq!(error.to_string(), format!("option {expected}"));
    }
    assert!(BlendOptions { max_alpha: f64::NAN, ..BlendOptions::default() }.validate().is_err());
}

#[test]
fn discs_and_whitened_gaussians_through_a_lens_are_refused_by_name_and_others_are_not() {
    let lens = Some(Lens::new(Distortion::new(Projection::Equidistant)));
    let camera = Camera { lens, ..axis_camera() };
    let leaves = capped().leaves();
    let blended =
        |options: BlendOptions| blend(&leaves.gaussians, &leaves.colours, None, &camera, &options).map(|_| ());
    for options in [with_maps(Form::Discs), hybrid(Transparency::Hybrid)] {
        let message = blended(options).unwrap_err().to_string();
        for part in ["`lens` is Equidistant", "only pinhole cameras", "data.undistort"] {
            assert!(message.contains(part), "{part}: {message}");
        }
    }
    blended(with_maps(Form::Ellipsoids)).unwrap();
}
