//! CPU and GPU: every operation on the same input, forward and backward, and whole renders.

use burn::tensor::{DType, Device, Tensor};
use dpges_core::camera::{Camera, CameraFromWorld, Lens};
use dpges_core::ops::blend::{BlendOptions, Form};
use dpges_core::ops::peel::PeelOptions;
use dpges_core::ops::unpack::{pack, unpack};
use dpges_core::render::blended::{BlendedOptions, render_blended};
use dpges_core::render::{RenderOptions, render};
use dpges_core::scene::{
    BlendOrder, ColourModel, DepthWeight, Footprint, HIGHEST_ALPHA, Peeling, ScreenFilter, Transparency,
};
use dpges_core::testing::golden::values;
use dpges_core::testing::kernels::limit_buffers;
use dpges_core::testing::lenses::{behind, every_model};
use dpges_core::testing::parity::{Bench, Named, Reference, distances};
use dpges_core::testing::scenes::{self, Recipe, TestScene};
use dpges_core::tiles::binning::cap_lists;
use dpges_core::tiles::lists::defer_readback;
use dpges_core::{Error, within_capacity};
use glam::DVec3;

use crate::devices::ndarray;

const TOLERANCE: f64 = 2e-4;

/// Pixels in which rounding may decide whether a fragment exists or is opaque.
const MAY_DISAGREE: f64 = 1e-4;

fn on<'a>(scene: &'a TestScene, options: PeelOptions, device: &Device) -> Bench<'a> {
    Bench::new(scene, options, device)
}

/// The results of the CPU, where the other device has the same layers.
fn expected(scene: &TestScene, options: PeelOptions, ids: &[i64]) -> (Reference, Vec<Named>) {
    let cpu = ndarray();
    let reference = on(scene, options, &cpu).reference().only_where(ids, options.layer_count);
    let expected = on(scene, options, &cpu).against(&reference);
    (reference, expected)
}

fn check(what: &str, scene: &TestScene, options: PeelOptions, device: &Device) {
    let (reference, expected) = expected(scene, options, &on(scene, options, device).ids());
    let apart = reference.disagreement();
    assert!(apart <= MAY_DISAGREE, "{what}: layers differ in {apart:.1e} of the pixels");
    let found = on(scene, options, device).against(&reference);
    assert!(found.len() > 50, "{what}: only {} tensors compared", found.len());
    assert_near(&format!("{what}, other layers in {apart:.1e} of the pixels"), &found, &expected);
}

fn assert_near(what: &str, found: &[Named], expected: &[Named]) {
    let distances = distances(found, expected);
    let (worst, far) = distances.iter().fold(("", 0.0), |w, (name, d)| if *d > w.1 { (name, *d) } else { w });
    println!("{what}: {} tensors, worst {worst} {far:.2e}", distances.len());
    let failures: Vec<String> =
        distances.iter().filter(|(_, d)| *d > TOLERANCE).map(|(name, d)| format!("{name} is off by {d:.2e}")).collect();
    assert!(failures.is_empty(), "{what}: {}", failures.join(", "));
}

/// Sorted blending; its lists and its order do not depend on layers.
fn check_blending(what: &str, scene: &TestScene, forms: &[(Form, ScreenFilter)], device: &Device) {
    for &(form, filter) in forms {
        for maps in [false, true] {
            let options = BlendOptions { form, filter, maps, ..BlendOptions::default() };
            let run = |device: &Device| on(scene, PeelOptions::default(), device).blended(options);
            assert_near(&format!("{what}, {form:?}, {filter:?}, maps {maps}"), &run(device), &run(&ndarray()));
        }
    }
}

/// Blending of what each pixel sorts by itself. Rounding may decide what is nearer, and rarely does: such pixels are
/// counted, and left out of the rest.
fn check_where_orders_agree(what: &str, scene: &TestScene, options: BlendOptions, device: &Device) {
    for maps in [false, true] {
        let options = BlendOptions { maps, ..options };
        let bench = |device: &Device| on(scene, PeelOptions::default(), device);
        let [found, expected] = [device, &ndarray()].map(|device| bench(device).blended_colour(options));
        let pixels = found.len() / 3;
        let agrees = |pixel: &usize| {
            (0..3).map(|channel| channel * pixels + pixel).all(|at| (found[at] - expected[at]).abs() < SWAPPED)
        };
        let agreed: Vec<f64> = (0..pixels).map(|pixel| f64::from(u8::from(agrees(&pixel)))).collect();
        let apart = 1.0 - agreed.iter().sum::<f64>() / pixels.max(1) as f64;
        assert!(apart <= MAY_SWAP, "{what}: colours differ in {apart:.1e} of the pixels");
        let run = |device: &Device| bench(device).blended_where(options, &agreed);
        let what = format!("{what}, by {}, maps {maps}, other orders in {apart:.1e} of the pixels", options.order);
        assert_near(&what, &run(device), &run(&ndarray()));
    }
}

fn check_by_rays(what: &str, scene: &TestScene, device: &Device) {
    let (filter, order) = (ScreenFilter::Plain, BlendOrder::Rays);
    check_where_orders_agree(what, scene, BlendOptions { filter, order, ..BlendOptions::default() }, device);
}

fn whitened(transparency: Transparency) -> BlendOptions {
    let (form, order) = (Form::Whitened, BlendOrder::Whitened(transparency));
    BlendOptions { form, order, max_alpha: HIGHEST_ALPHA, ..BlendOptions::default() }
}

/// Everything that pixels sort by themselves.
fn check_by_pixels(what: &str, scene: &TestScene, device: &Device) {
    check_by_rays(what, scene, device);
    for transparency in [Transparency::Hybrid, Transparency::Nearest, Transparency::Sorted, Transparency::Tail] {
        check_where_orders_agree(what, scene, whitened(transparency), device);
    }
}

/// Difference of colours that only another order makes, and share of the pixels that may have one.
const SWAPPED: f64 = 1e-4;
const MAY_SWAP: f64 = 2e-3;

const FORMS: [(Form, ScreenFilter); 4] = [
    (Form::Ellipsoids, ScreenFilter::Compensated),
    (Form::Ellipsoids, ScreenFilter::Plain),
    (Form::Discs, ScreenFilter::Compensated),
    (Form::Students, ScreenFilter::Off),
];

fn random(seed: u64, model: ColourModel) -> TestScene {
    scenes::random(seed, &Recipe { surfels: 150, gaussians: 400, width: 75, height: 50, model, ..Recipe::default() })
}

pub fn every_operation_agrees_on_random_scenes(device: &Device) {
    let models = [
        ColourModel::SphericalBeta { lobes: 2 },
        ColourModel::SphericalHarmonics { degree: 3 },
        ColourModel::SphericalBeta { lobes: 0 },
    ];
    for (seed, model) in (30..).zip(models) {
        check(&format!("seed {seed}, {model}"), &random(seed, model), PeelOptions::default(), device);
    }
}

pub fn every_operation_agrees_for_every_number_of_layers_and_footprint(device: &Device) {
    let scene = random(41, ColourModel::SphericalBeta { lobes: 1 });
    for layer_count in [1, 2, 4, 8] {
        for (footprint, modulation) in [(Footprint::Kernel, 30.0), (Footprint::Opacity, 255.0)] {
            for peeling in [Peeling::Continuous, Peeling::Nearest] {
                let options = PeelOptions { layer_count, modulation, footprint, peeling };
                check(&format!("{options:?}"), &scene, options, device);
            }
        }
    }
}

pub fn every_operation_agrees_on_a_realistic_scene(device: &Device) {
    check("realistic", &scenes::realistic(900, 9_000, 120, 80, 1), PeelOptions::default(), device);
}

pub fn every_operation_agrees_with_nothing_to_show(device: &Device) {
    for (surfels, gaussians) in [(0, 0), (5, 0), (0, 5)] {
        let scene = scenes::random(50, &Recipe { surfels, gaussians, ..Recipe::default() });
        check(&format!("{surfels} surfels, {gaussians} Gaussians"), &scene, PeelOptions::default(), device);
    }
}

pub fn every_operation_agrees_on_one_primitive_and_on_a_line_of_pixels(device: &Device) {
    for (surfels, gaussians, width, height) in [(1, 1, 37, 22), (12, 20, 1, 1), (12, 20, 33, 1), (12, 20, 1, 17)] {
        let scene = scenes::random(51, &Recipe { surfels, gaussians, width, height, ..Recipe::default() });
        let what = format!("{surfels} surfels, {gaussians} Gaussians, {width} × {height} px");
        check(&what, &scene, PeelOptions::default(), device);
    }
}

/// Through a lens of every model. Wide ones stand within the scene and see 150° across their picture, others as before.
pub fn every_operation_agrees_through_lenses(device: &Device) {
    for (seed, (name, lens)) in (100..).zip(every_model()) {
        let mut scene = random(seed, ColourModel::SphericalBeta { lobes: 0 });
        if Lens::new(lens).is_wide() {
            let pose = CameraFromWorld::look_at(DVec3::new(0.2, -0.3, 0.1), DVec3::new(1.0, 0.4, -0.2), DVec3::Z);
            scene.camera = Camera { camera_from_world: pose, near: 0.2, ..scene.camera };
        }
        scene.camera = behind(scene.camera, lens, 150.0);
        check(name, &scene, PeelOptions::default(), device);
        // sorted methods, which differ only by what a pixel's ray is, through the two with most coefficients
        if ["FULL_OPENCV", "THIN_PRISM_FISHEYE"].contains(&name) {
            check_blending(name, &scene, &FORMS[..2], device);
            check_by_rays(name, &scene, device);
        }
    }
}

pub fn weighted_sums_agree_on_random_scenes(device: &Device) {
    let model = ColourModel::HarmonicsAndOpacity { degree: 3 };
    for (seed, weight) in (95..).zip([DepthWeight::Direct, DepthWeight::Exponential, DepthWeight::Linear]) {
        for (gaussians, width, height) in [(400, 75, 50), (1, 37, 22), (0, 9, 5)] {
            let recipe = Recipe { surfels: 0, gaussians, width, height, model, ..Recipe::default() };
            let scene = scenes::random(seed, &recipe);
            let run = |device: &Device| on(&scene, PeelOptions::default(), device).summed(weight);
            assert_near(&format!("{weight:?}, {gaussians} Gaussians"), &run(device), &run(&ndarray()));
        }
    }
}

pub fn sorted_blending_agrees_on_random_scenes(device: &Device) {
    for seed in 90..92 {
        let scene = random(seed, ColourModel::SphericalBeta { lobes: 0 });
        check_blending(&format!("seed {seed}"), &scene, &FORMS, device);
        check_by_pixels(&format!("seed {seed}"), &scene, device);
    }
}

pub fn sorted_blending_agrees_in_a_crowd(device: &Device) {
    // several blocks to sort, lists longer than a cube has units, pixels that end early
    let recipe = Recipe { surfels: 0, gaussians: 2_500, width: 40, height: 30, ..Recipe::default() };
    let scene = scenes::random(94, &recipe);
    check_blending("a crowd", &scene, &FORMS[..1], device);
    check_by_pixels("a crowd", &scene, device);
}

pub fn sorted_blending_agrees_with_little_or_nothing_to_show(device: &Device) {
    for gaussians in [0, 1, 5] {
        let scene = scenes::random(95, &Recipe { surfels: 0, gaussians, ..Recipe::default() });
        check_blending(&format!("{gaussians} primitives"), &scene, &FORMS, device);
        check_by_pixels(&format!("{gaussians} primitives"), &scene, device);
    }
}

/// A comparison is worth something only if it fails where it should.
pub fn a_device_that_is_off_is_found_out() {
    let scene = random(60, ColourModel::SphericalBeta { lobes: 2 });
    let options = PeelOptions::default();
    let mut ids = on(&scene, options, &ndarray()).ids();
    let (_, expected) = expected(&scene, options, &ids);
    for at in 0..expected.len() {
        let mut found = expected.clone();
        let Some(value) = found[at].1.iter_mut().filter(|v| v.is_finite()).max_by(|a, b| a.abs().total_cmp(&b.abs()))
        else {
            continue;
        };
        *value += 1.0 + value.abs();
        let far: Vec<String> =
            distances(&found, &expected).into_iter().filter(|(_, d)| *d > 0.0).map(|(name, _)| name).collect();
        assert_eq!(far, [expected[at].0.clone()]);
    }
    ids[7] += 1;
    let apart = self::expected(&scene, options, &ids).0.disagreement();
    assert!((apart * (75.0 * 50.0) - 1.0).abs() < 1e-6, "one pixel is other: {apart}");
}

pub fn lists_that_overflow_change_nothing(device: &Device) {
    let scene = random(70, ColourModel::SphericalBeta { lobes: 2 });
    cap_lists(100);
    check("lists of 100 entries", &scene, PeelOptions::default(), device);
    check_blending("lists of 100 entries", &scene, &FORMS, device);
    check_by_pixels("lists of 100 entries", &scene, device);
    cap_lists(usize::MAX);
}

/// Every operation on a scene, forward and backward.
fn everything(scene: &TestScene, device: &Device) -> Vec<Named> {
    let options = PeelOptions::default();
    let reference = on(scene, options, device).reference();
    let mut found = on(scene, options, device).against(&reference);
    let by_centres = FORMS.map(|(form, filter)| BlendOptions { form, filter, ..BlendOptions::default() });
    let by_rays = BlendOptions { order: BlendOrder::Rays, ..BlendOptions::default() };
    for options in by_centres.into_iter().chain([by_rays, whitened(Transparency::Hybrid)]) {
        found.extend(on(scene, PeelOptions::default(), device).blended(BlendOptions { maps: true, ..options }));
    }
    found
}

pub fn lists_whose_lengths_nothing_waits_for_change_no_bit(device: &Device) {
    let scene = random(71, ColourModel::SphericalBeta { lobes: 2 });
    let expected = everything(&scene, device);
    // with room at once, without it the second time
    for (entries, calls) in [(usize::MAX, 1), (100, 2)] {
        let mut called = 0;
        cap_lists(entries);
        let found = defer_readback(|| {
            called += 1;
            everything(&scene, device)
        });
        cap_lists(usize::MAX);
        let other = found.iter().zip(&expected).find(|(found, expected)| found != expected);
        assert!(other.is_none() && found.len() == expected.len(), "{entries} entries: {:?}", other.map(|(f, _)| &f.0));
        assert_eq!(called, calls, "{entries} entries");
    }
}

/// Scenes with some Gaussians that fill the picture.
fn with_large_ones(mut scene: TestScene, large: usize) -> TestScene {
    for i in 0..large {
        scene.gaussians.log_scales[3 * i..3 * i + 3].copy_from_slice(&[1.2, 1.5, 0.9]);
        scene.gaussians.opacities[i] = 0.2;
    }
    scene
}

pub fn primitives_larger_than_the_picture_agree(device: &Device) {
    let mut scene = with_large_ones(scenes::realistic(300, 2_000, 200, 150, 3), 6);
    scene.surfels.log_scales[..6].copy_from_slice(&[0.3, 0.1, 0.2, 0.4, 0.0, 0.3]);
    check("larger than the picture", &scene, PeelOptions::default(), device);
    check_blending("larger than the picture", &scene, &FORMS, device);
    check_by_pixels("larger than the picture", &scene, device);
}

pub fn gradients_beyond_the_largest_buffer_are_gathered_in_parts(device: &Device) {
    let recipe = Recipe { surfels: 0, gaussians: 2_500, width: 40, height: 30, ..Recipe::default() };
    let scene = with_large_ones(scenes::random(96, &recipe), 1_500);
    // the sums of a tile fit, and what its pixels say, those of all six do not
    let by = |order| BlendOptions { order, ..BlendOptions::default() };
    for (options, most) in [
        (by(BlendOrder::Centres), 180_000),
        (by(BlendOrder::Rays), 6_000_000),
        (whitened(Transparency::Hybrid), 250_000),
    ] {
        let run = || {
            let options = BlendOptions { maps: true, ..options };
            on(&scene, PeelOptions::default(), device).blended(options)
        };
        let whole = run();
        limit_buffers(most);
        let in_parts = run();
        limit_buffers(usize::MAX);
        assert_near(&format!("in parts, by {}", options.order), &in_parts, &whole);
    }
}

/// Forward by the functions themselves, backward by `within_capacity`; the device goes on to work as before.
pub fn what_no_buffer_holds_is_refused_by_name(device: &Device) {
    let recipe = Recipe { surfels: 0, gaussians: 100, width: 200, height: 150, ..Recipe::default() };
    let scene = with_large_ones(scenes::random(97, &recipe), 100);
    let (surfels, gaussians) = scene.leaves(&device.clone().autodiff(), DType::F32);
    let options = BlendedOptions { blend: BlendOptions::default(), background: [0.0; 3] };
    let peeled = || render(&surfels, &gaussians, &scene.camera, &RenderOptions::default()).map(|r| r.composite.image);
    let blended = || render_blended(&gaussians, &scene.camera, &options).map(|r| r.image);
    let [before_peeled, before_blended] = [peeled().unwrap(), blended().unwrap()];
    for (what, forward) in [("peeled", &peeled as &dyn Fn() -> dpges_core::Result<Tensor<3>>), ("blended", &blended)] {
        // too large are the layers and, with room for them, the sums; the lists and, with room for them, the planes
        for most in [20_000, 370_000] {
            limit_buffers(most);
            let refused = forward();
            limit_buffers(usize::MAX);
            let error = refused.expect_err("too large");
            assert!(matches!(error, Error::Capacity { largest, .. } if largest == most as u64), "{what}: {error}");
        }
    }
    limit_buffers(40_000);
    let refused = blended();
    limit_buffers(1_000);
    let loss = before_blended.clone().sum();
    let backward = within_capacity(|| drop(loss.backward()));
    limit_buffers(usize::MAX);
    let message = refused.expect_err("too many entries").to_string();
    assert!(message.contains("the 100 primitives of this view touch"), "{message}");
    assert!(message.contains("at most 40000"), "{message}");
    assert!(matches!(backward, Err(Error::Capacity { largest: 1_000, .. })), "{backward:?}");
    for (before, after) in [(before_peeled, peeled()), (before_blended, blended())] {
        assert_eq!(values(&before), values(&after.unwrap()));
    }
}

pub fn every_operation_gives_the_same_bits_every_time(device: &Device) {
    let scene = with_large_ones(scenes::realistic(300, 4_000, 96, 64, 2), 2);
    let first = everything(&scene, device);
    assert!(everything(&scene, device) == first, "two runs differ");
}

pub fn doubles_on_a_gpu_are_refused_by_name(device: &Device) {
    if !device.supports_dtype(DType::F64) {
        return;
    }
    let scene = random(80, ColourModel::SphericalBeta { lobes: 1 });
    let (surfels, gaussians) = scene.tensors(device, DType::F64);
    let error = render(&surfels, &gaussians, &scene.camera, &Default::default()).unwrap_err();
    assert!(error.to_string().contains("F32, what GPUs compute in"), "{error}");
}

/// All values, in every place of a word, in images whose last word is full or not.
pub fn photographs_are_unpacked_to_the_same_bits(device: &Device) {
    for shape in [[1, 1, 1], [3, 16, 17], [1, 13, 20], [2, 128, 3], [3, 480, 641]] {
        let values: Vec<u8> = (0..shape.iter().product()).map(|at: usize| (at * 37 % 256) as u8).collect();
        let [expected, found] = [ndarray(), device.clone()].map(|device| {
            let image = unpack(&pack(&values, &device), shape).unwrap();
            assert_eq!(image.dims(), shape);
            image.into_data().iter::<f32>().map(f32::to_bits).collect::<Vec<_>>()
        });
        assert!(found == expected, "{shape:?}");
    }
}
