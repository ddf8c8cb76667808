//! Changes that must not change the picture: the order of primitives, the backend, another run.

use burn::tensor::{DType, Device};
use dpges_core::losses::{LossWeights, losses};
use dpges_core::render::{Render, RenderOptions, render};
use dpges_core::scene::schema::{Attribute, Columns};
use dpges_core::testing::golden::values;
use dpges_core::testing::random::Random;
use dpges_core::testing::scenes::{Recipe, TestScene, random};

use crate::devices::{flex, ndarray};

const BACKGROUND: [f64; 3] = [0.1, 0.6, 0.3];

fn scene() -> TestScene {
    random(17, &Recipe { surfels: 120, gaussians: 300, width: 61, height: 43, ..Recipe::default() })
}

fn options() -> RenderOptions {
    RenderOptions { background: BACKGROUND, ..RenderOptions::default() }
}

fn rendered(scene: &TestScene, device: &Device) -> Render {
    let (surfels, gaussians) = scene.tensors(device, DType::F32);
    render(&surfels, &gaussians, &scene.camera, &options()).unwrap()
}

fn ids(render: &Render) -> Vec<i64> {
    render.layers.ids.clone().into_data().iter::<i64>().collect()
}

/// Every output, by name.
fn outputs(render: &Render) -> Vec<(&'static str, Vec<f64>)> {
    let composite = &render.composite;
    vec![
        ("image", values(&composite.image)),
        ("surfel image", values(&composite.surfel_image)),
        ("weights", values(&render.seen.weights)),
        ("transmittance", values(&render.seen.transmittance)),
        ("Gaussian colour", values(&composite.gaussian_colour)),
        ("Gaussian weight", values(&composite.gaussian_weight)),
        ("alpha", values(&render.layers.alpha)),
        ("depth", values(&render.layers.depth)),
        ("limits", values(&render.seen.limits)),
        ("surfel colours", values(&render.surfel_colours)),
        ("Gaussian colours", values(&render.gaussian_colours)),
    ]
}

fn shuffled(count: usize, seed: u64) -> Vec<usize> {
    let (mut order, mut random) = ((0..count).collect::<Vec<_>>(), Random::new(seed));
    (1..count).for_each(|i| order.swap(i, random.below(i + 1)));
    order
}

#[test]
fn the_order_of_primitives_does_not_matter() {
    let scene = scene();
    let reference = rendered(&scene, &flex());
    for seed in 1..4 {
        let order = shuffled(scene.surfels.len(), seed);
        let permuted = TestScene {
            surfels: scene.surfels.select(&order),
            gaussians: scene.gaussians.select(&shuffled(scene.gaussians.len(), seed + 10)),
            ..scene.clone()
        };
        let found = rendered(&permuted, &flex());
        let back: Vec<i64> =
            ids(&found).iter().map(|&id| usize::try_from(id).map_or(-1, |id| order[id] as i64)).collect();
        assert_eq!(back, ids(&reference));
        assert_eq!(values(&found.layers.alpha), values(&reference.layers.alpha));
        assert_eq!(values(&found.layers.depth), values(&reference.layers.depth));
        let (a, b) = (values(&found.composite.image), values(&reference.composite.image));
        let apart = a.iter().zip(&b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(apart < 1e-6, "{apart:e}");
        assert!(a.iter().any(|v| *v > 0.2));
    }
}

#[test]
fn both_backends_render_the_same_bits() {
    let (a, b) = (rendered(&scene(), &ndarray()), rendered(&scene(), &flex()));
    assert_eq!(ids(&a), ids(&b));
    for ((name, a), (_, b)) in outputs(&a).into_iter().zip(outputs(&b)) {
        assert!(a == b, "{name} differs");
    }
}

/// Outputs, total loss and the gradients of all parameters.
fn step(device: &Device) -> Vec<Vec<f64>> {
    let scene = scene();
    let (surfels, gaussians) = scene.leaves(&device.clone().autodiff(), DType::F32);
    let rendered = render(&surfels, &gaussians, &scene.camera, &options()).unwrap();
    let target = rendered.composite.image.clone().detach().mul_scalar(0.9).add_scalar(0.02);
    let terms = losses(&rendered, surfels.log_scales.clone(), target, &LossWeights::default()).unwrap();
    let mut all: Vec<Vec<f64>> = outputs(&rendered).into_iter().map(|(_, values)| values).collect();
    all.push(values(&terms.total));
    let gradients = terms.total.backward();
    let model = gaussians.model();
    let learns = |attribute: &Attribute| attribute.learns() && !attribute.is_left_out(model);
    let parameters = surfels.iter().chain(gaussians.iter()).filter(|(attribute, _)| learns(attribute));
    all.extend(parameters.map(|(_, tensor)| values(&tensor.grad(&gradients).unwrap())));
    all
}

#[test]
fn a_second_run_has_the_same_bits() {
    for device in [ndarray(), flex()] {
        let first = step(&device);
        assert!(first.iter().all(|values| values.iter().any(|v| *v != 0.0)));
        (0..3).for_each(|_| assert!(step(&device) == first));
    }
}

#[test]
fn nothing_is_rendered_as_the_background() {
    let whole = scene();
    let nothing = TestScene { surfels: whole.surfels.select(&[]), gaussians: whole.gaussians.select(&[]), ..whole };
    for device in [ndarray(), flex()] {
        let Render { composite, seen, .. } = rendered(&nothing, &device);
        let plane = nothing.camera.width * nothing.camera.height;
        for (at, value) in values(&composite.image).into_iter().enumerate() {
            approx::assert_relative_eq!(value, BACKGROUND[at / plane], epsilon = 1e-6);
        }
        assert!(values(&seen.transmittance).iter().all(|t| *t == 1.0));
    }
}
