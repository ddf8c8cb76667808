//! A million primitives, and pictures of 8192 px: nothing is left out, everything is finite, and 32 bits are enough.

use burn::tensor::{DType, Device, Gradients, Tensor};
use dpges_core::camera::{Camera, CameraFromWorld};
use dpges_core::ops::blend::Form;
use dpges_core::ops::finite::{FiniteChecks, check_finite};
use dpges_core::ops::peel::PeelOptions;
use dpges_core::render::blended::render_blended;
use dpges_core::render::{Render, RenderOptions, render};
use dpges_core::scene::schema::Columns;
use dpges_core::scene::{ColourModel, Footprint, GaussianData, Gaussians, Peeling, SurfelData, Surfels};
use dpges_core::testing::compare::relative_l2;
use dpges_core::testing::golden::values;
use dpges_core::testing::scenes::{TestScene, realistic};
use dpges_core::{Error, Result};
use dpges_train::metrics::psnr;
use glam::{DMat3, DVec3};

use crate::poisoned::blended;

pub const MILLION: usize = 1_000_000;
/// Edge of a picture with a pixel for each of them, px.
const EDGE: usize = 1_000;
/// Depths of all surfels and all Gaussians, world units, and the margin of the surfels, which does not reach the Gaussians.
const SURFELS_AT: f64 = 2.0;
const GAUSSIANS_AT: f64 = 1.9;
const MARGIN: f32 = 0.01;
/// Surfels are half transparent, so that their opacity has a gradient, and Gaussians too.
const HALF: f64 = 0.5;

/// At the origin.
pub fn camera(width: usize, height: usize) -> Camera {
    let pose = CameraFromWorld { rotation: DMat3::IDENTITY, translation: DVec3::ZERO };
    Camera::pinhole(pose, width.max(height) as f64, [width, height], 0.1)
}

/// `count` surfels and Gaussians that face the camera, with standard deviations of `sigmas_px`, where `place` says for each.
fn facing(count: usize, camera: Camera, sigmas_px: [f64; 2], place: impl Fn(usize) -> [[f64; 2]; 2]) -> TestScene {
    let model = ColourModel::SphericalBeta { lobes: 0 };
    let (mut surfels, mut gaussians) = (SurfelData::neutral(model, count), GaussianData::neutral(model, count));
    let at = |[x, y]: [f64; 2], depth: f64| camera.unproject(x, y, depth).as_vec3().to_array();
    for i in 0..count {
        let [surfel, gaussian] = place(i);
        surfels.positions[3 * i..3 * i + 3].copy_from_slice(&at(surfel, SURFELS_AT));
        gaussians.positions[3 * i..3 * i + 3].copy_from_slice(&at(gaussian, GAUSSIANS_AT));
    }
    let [of_surfels, of_gaussians] = sigmas_px;
    surfels.log_scales.fill((of_surfels * SURFELS_AT / camera.fx).ln() as f32);
    gaussians.log_scales.fill((of_gaussians * GAUSSIANS_AT / camera.fx).ln() as f32);
    surfels.margins.fill(MARGIN);
    gaussians.opacities.fill(HALF as f32);
    TestScene { surfels, gaussians, camera }
}

fn peeled(layer_count: usize) -> RenderOptions {
    let peel = PeelOptions { layer_count, modulation: HALF, footprint: Footprint::Kernel, peeling: Peeling::Nearest };
    RenderOptions { peel, ..RenderOptions::default() }
}

fn gradient(leaf: &Tensor<2>, gradients: &Gradients) -> Vec<f64> {
    values(&leaf.grad(gradients).expect("a gradient"))
}

fn assert_gradients_are_finite(what: &str, (surfels, gaussians): (&Surfels, &Gaussians), gradients: &Gradients) {
    let mut checks = FiniteChecks::default();
    for (attribute, leaf) in surfels.iter().chain(gaussians.iter()).filter(|(attribute, _)| attribute.learns()) {
        if let Some(gradient) = leaf.grad(gradients) {
            checks.add(attribute.name, &gradient);
        }
    }
    check_finite(checks).unwrap_or_else(|error| panic!("{what}, gradients: {error}"));
}

/// The first of `numbers` that is not above 0.
fn assert_all_above_0(what: &str, numbers: &[f64]) {
    let bad = numbers.iter().position(|&number| number.is_nan() || number <= 0.0);
    assert!(bad.is_none(), "{what}: number {bad:?} of {} is {}", numbers.len(), numbers[bad.unwrap_or(0)]);
}

/// Each surfel covers the middle of its own pixel only, and each Gaussian has its middle there: no layer, no sum and no
/// gradient may lack any of them.
pub fn each_of_a_million_has_its_pixel(device: &Device, dtype: DType) {
    let middle = |i: usize| [(i % EDGE) as f64 + 0.5, (i / EDGE) as f64 + 0.5];
    // surfels beside it, so that the gradients of their scales do not vanish
    let scene = facing(MILLION, camera(EDGE, EDGE), [0.1, 0.3], |i| [middle(i).map(|v| v + 0.05), middle(i)]);
    let (surfels, gaussians) = scene.leaves(&device.clone().autodiff(), dtype);
    let Render { composite, layers, .. } = render(&surfels, &gaussians, &scene.camera, &peeled(1)).unwrap();
    let ids = layers.ids.clone().into_data();
    let lost = ids.iter::<i64>().zip(0..).position(|(found, expected)| found != expected);
    assert!(lost.is_none(), "pixel {lost:?} does not show its surfel");
    // exp(−¼) of a half
    assert!(values(&layers.alpha).iter().all(|alpha| (alpha - 0.3894).abs() < 5e-3), "opacities of surfels");
    let weights = values(&composite.gaussian_weight);
    assert!(weights.iter().all(|weight| (0.2..0.6).contains(weight)), "weights of Gaussians");

    let gradients = (composite.gaussian_weight.sum() + layers.alpha.sum()).backward();
    assert_gradients_are_finite("a million, peeled", (&surfels, &gaussians), &gradients);
    assert_all_above_0("gradients of the scales of surfels", &gradient(&surfels.log_scales, &gradients));
    let of_opacities = gradient(&gaussians.opacities, &gradients);
    assert_all_above_0("gradients of opacities", &of_opacities);
    // the weight is linear in the opacities: their gradients times them are the weight
    let (expected, found) = (weights.iter().sum::<f64>(), HALF * of_opacities.iter().sum::<f64>());
    assert!((found / expected - 1.0).abs() < 1e-4, "all opacities and gradients are {found}, the weight is {expected}");

    for form in [Form::Ellipsoids, Form::Discs] {
        let (surfels, gaussians) = scene.leaves(&device.clone().autodiff(), dtype);
        let alpha = render_blended(&gaussians, &scene.camera, &blended(form)).unwrap().blend.alpha;
        assert!(values(&alpha).iter().all(|alpha| *alpha > 0.2 && *alpha < 1.0), "{form:?}: alpha");
        let gradients = alpha.sum().backward();
        assert_gradients_are_finite(&format!("a million, {form:?}"), (&surfels, &gaussians), &gradients);
        assert_all_above_0(&format!("{form:?}: gradients of opacities"), &gradient(&gaussians.opacities, &gradients));
    }
}

/// Equal primitives at one point: the first are the layers, all `many` of them add up, and each has the gradient that one
/// has.
pub fn equal_primitives_add_up(many: usize, device: &Device, dtype: DType) {
    let camera = camera(17, 9);
    let run = |count: usize| {
        let scene = facing(count, camera, [3.0, 1.0], |_| [[8.7, 4.4]; 2]);
        let (surfels, gaussians) = scene.leaves(&device.clone().autodiff(), dtype);
        let Render { composite, layers, .. } = render(&surfels, &gaussians, &camera, &peeled(3)).unwrap();
        let weights = values(&composite.gaussian_weight);
        let gradients = composite.gaussian_weight.sum().backward();
        assert_gradients_are_finite(&format!("{count} at one point"), (&surfels, &gaussians), &gradients);
        (layers.ids.into_data().iter::<i64>().collect::<Vec<_>>(), weights, gradient(&gaussians.opacities, &gradients))
    };
    let (_, of_one, gradient_of_one) = run(1);
    let (ids, of_all, gradients) = run(many);
    let pixels = camera.width * camera.height;
    for (pixel, id) in ids.iter().enumerate() {
        let nearest = (pixel / pixels) as i64;
        assert!(*id == nearest || *id == -1, "layer {nearest} shows surfel {id}");
    }
    assert!(ids.iter().filter(|&&id| id == 2).count() > 40, "three layers");
    // in 32 bits a sum grows by steps that are rounded to its own size
    let tolerance = if dtype == DType::F64 { 1e-9 } else { 5e-2 };
    for (one, all) in of_one.iter().zip(&of_all) {
        assert!((all - many as f64 * one).abs() <= tolerance * all.abs(), "{all} of {many}, {one} of one");
    }
    assert!(of_one.iter().any(|weight| *weight > 0.1), "{of_one:?}");
    let apart = gradients.iter().position(|g| (g / gradient_of_one[0] - 1.0).abs() > 1e-4);
    assert!(apart.is_none(), "Gaussian {apart:?} has another gradient than {}", gradient_of_one[0]);
}

/// A room that fills a picture of any size, with primitives 64 times as large as is realistic where its longer edge has
/// 8192 px.
fn room(width: usize, height: usize) -> TestScene {
    let mut scene = realistic(600, 6_000, 128, 128, 5);
    let (camera, scale) = (&mut scene.camera, width.max(height) as f64 / 128.0);
    (camera.fx, camera.fy) = (scale * camera.fx, scale * camera.fy);
    (camera.cx, camera.cy) = (0.5 * width as f64, 0.5 * height as f64);
    (camera.width, camera.height) = (width, height);
    scene
}

/// The last pixels of the picture of `camera`, and the first.
fn corners(camera: &Camera) -> [(Camera, [usize; 2]); 2] {
    let [width, height] = [camera.width, camera.height].map(|edge| edge.min(64));
    [[camera.width - width, camera.height - height], [0, 0]].map(|[x, y]| {
        let (cx, cy) = (camera.cx - x as f64, camera.cy - y as f64);
        (Camera { cx, cy, width, height, ..*camera }, [x, y])
    })
}

/// The picture of `camera` by `draw`, after its corners were compared with pictures of those alone.
fn with_equal_corners(what: &str, camera: &Camera, draw: impl Fn(&Camera) -> Result<Tensor<3>>) -> Result<Tensor<3>> {
    let whole = draw(camera)?;
    for (part, [x, y]) in corners(camera) {
        let expected = draw(&part)?.inner();
        let found = whole.clone().inner().slice([0..3, y..y + part.height, x..x + part.width]);
        let near = psnr(found, expected.clone());
        // not the same: Gaussians beyond the border are projected as if they were at it
        assert!(near > 30.0, "{what}: the part at ({x}, {y}) px is {near} dB from itself alone");
        let seen = values(&expected).iter().fold(0.0f64, |largest, value| largest.max(value.abs()));
        assert!(seen > 0.05, "{what}: nothing is seen in the part at ({x}, {y}) px");
    }
    Ok(whole)
}

/// Picture and gradients of a loss, peeled and blended; the names are those of attributes.
fn outcome(what: &str, scene: &TestScene, device: &Device, dtype: DType) -> Vec<(String, Vec<f64>)> {
    let mut found = Vec::new();
    for is_peeled in [true, false] {
        let (surfels, gaussians) = scene.leaves(&device.clone().autodiff(), dtype);
        let draw = |camera: &Camera| {
            if is_peeled {
                return render(&surfels, &gaussians, camera, &RenderOptions::default()).map(|r| r.composite.image);
            }
            render_blended(&gaussians, camera, &blended(Form::Ellipsoids)).map(|r| r.image)
        };
        let kind = if is_peeled { "peeled" } else { "blended" };
        let image = with_equal_corners(&format!("{what}, {kind}"), &scene.camera, draw).unwrap();
        let gradients = (image.clone() - 0.5).square().mean().backward();
        found.push((format!("{kind}: image"), values(&image)));
        for (attribute, leaf) in surfels.iter().chain(gaussians.iter()).filter(|(attribute, _)| attribute.learns()) {
            if let Some(gradient) = leaf.grad(&gradients) {
                found.push((format!("{kind}: {}", attribute.name), values(&gradient)));
            }
        }
    }
    found
}

/// Pictures 8192 px wide or high in 32 bits on `device` and in 64 bits on a CPU.
pub fn pictures_of_8192_px_are_close(device: &Device) {
    for (width, height) in [(8192, 64), (64, 8192)] {
        let (scene, what) = (room(width, height), format!("{width} × {height} px"));
        let found = outcome(&what, &scene, device, DType::F32);
        let exact = outcome(&what, &scene, &crate::devices::ndarray(), DType::F64);
        assert_eq!(found.len(), exact.len());
        assert!(found.len() >= 17, "{} tensors", found.len());
        for ((name, found), (_, exact)) in found.iter().zip(&exact) {
            let apart = relative_l2(found, exact);
            println!("{what}, {name}: {apart:.1e}");
            assert!(apart < 2e-2, "{what}, {name}: {apart:.1e} from 64 bits");
        }
    }
}

/// 8192² px, or a typed error of a device that has no buffers for them.
pub fn the_largest_picture(device: &Device) {
    let scene = room(8192, 8192);
    let (surfels, gaussians) = scene.leaves(&device.clone().autodiff(), DType::F32);
    let draw = |camera: &Camera| {
        let peel = PeelOptions { layer_count: 1, ..PeelOptions::default() };
        let options = RenderOptions { peel, ..RenderOptions::default() };
        render(&surfels, &gaussians, camera, &options).map(|rendered| rendered.composite.image)
    };
    let image = match with_equal_corners("8192² px", &scene.camera, draw) {
        Err(Error::Capacity { what, needed, largest }) => {
            return println!("refused: {what} takes {needed} bytes, a buffer {largest}");
        }
        image => image.unwrap(),
    };
    let mut checks = FiniteChecks::default();
    checks.add("image", &image);
    check_finite(checks).unwrap();
    let gradients = image.sum().backward();
    assert_gradients_are_finite("8192² px", (&surfels, &gaussians), &gradients);
    let of_base = gradient(&gaussians.colour.base, &gradients);
    let seen = of_base.iter().filter(|gradient| **gradient != 0.0).count();
    assert!(10 * seen > of_base.len(), "only {seen} of {} colours have a gradient", of_base.len());
}
