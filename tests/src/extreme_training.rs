//! Training of scenes at the extremes: in f32 it ends where it ends in f64.
//!
//! Learning rates fall. With constant ones a run in f64 whose positions begin a unit in the last place of an f32 away ends
//! up to 10 % away, and says nothing about arithmetic.

use burn::tensor::{DType, Device, Tensor, TensorData};
use dpges_core::losses::{LossWeights, losses};
use dpges_core::ops::adam::{AdamStep, adam_step};
use dpges_core::render::{RenderOptions, render};
use dpges_core::scene::schema::{Attribute, Columns, GaussianColumns, RateGroup, SurfelColumns};
use dpges_core::scene::{ColourModel, Gaussians, Surfels};
use dpges_core::testing::extremes::{Hazard, extreme_of};
use dpges_core::testing::golden::values;
use dpges_core::testing::scenes::{Recipe, TestScene, random};

use crate::devices::ndarray;

const STEPS: u64 = 200;
const SEEDS: u64 = 2;
/// Largest difference of the losses at the end, relative to that in f64.
const TOLERANCE: f64 = 0.01;
const RECIPE: Recipe = Recipe {
    surfels: 8,
    gaussians: 16,
    model: ColourModel::SphericalBeta { lobes: 2 },
    extent: 1.0,
    width: 24,
    height: 18,
};

/// A scene, what it should look like, and half the size of its world, world units.
struct Case {
    name: &'static str,
    scene: TestScene,
    target: TestScene,
    extent: f64,
}

/// The extremes of a seed. A target has the same camera and other primitives.
fn cases(seed: u64) -> impl Iterator<Item = Case> {
    let needles = extreme_of(Hazard::Needles, seed).scene;
    let mut far = random(seed, &RECIPE);
    far.camera.near = far.camera.centre().length() * 1e-5;
    let large = random(seed, &Recipe { extent: 1e7, ..RECIPE });
    let mut opaque = random(seed, &RECIPE);
    for (i, opacity) in opaque.gaussians.opacities.iter_mut().enumerate() {
        *opacity = if i % 2 == 0 { 100.0 } else { 0.0 };
    }
    let scenes = [
        ("needles", needles, 1.0),
        ("10⁵ near planes away", far, 1.0),
        ("10⁷ world units", large, 1e7),
        ("opacities of 0 and 100", opaque, 1.0),
    ];
    scenes.into_iter().map(move |(name, scene, extent)| {
        let others = random(seed + 100, &Recipe { extent, ..RECIPE });
        Case { name, target: TestScene { camera: scene.camera, ..others }, scene, extent }
    })
}

/// At first about ten times those of the presets, as 200 steps are few; a hundredth of that at the end, where runs that
/// rounding has sent along other paths come to the same loss.
fn rate(attribute: &Attribute, extent: f64, time: u64) -> f64 {
    let first = match attribute.rate {
        RateGroup::Positions => 2e-3 * extent,
        RateGroup::Quaternions | RateGroup::LogScales | RateGroup::Detail => 5e-3,
        RateGroup::Opacities | RateGroup::Base => 2e-2,
        _ => 0.0,
    };
    first * 0.01f64.powf(time as f64 / STEPS as f64)
}

/// One tensor of a scene and its moments.
struct Parameter {
    attribute: &'static Attribute,
    value: Tensor<2>,
    moments: [Tensor<2>; 2],
}

/// The loss before the first step and after the last.
fn train(case: &Case, device: &Device, dtype: DType) -> [f64; 2] {
    let (camera, model) = (&case.scene.camera, case.scene.gaussians.model());
    let target = picture(&case.target, device, dtype);
    let (surfels, gaussians) = case.scene.tensors(device, dtype);
    let surfel_list = SurfelColumns::<()>::ATTRIBUTES.iter().zip(surfels.into_list());
    let count = surfel_list.len();
    let list = surfel_list.chain(GaussianColumns::<()>::all_attributes().zip(gaussians.into_list()));
    let mut parameters: Vec<Parameter> = list
        .map(|(attribute, value)| {
            let zero = || value.zeros_like();
            Parameter { attribute, moments: [zero(), zero()], value }
        })
        .collect();
    let gate = Tensor::<1>::ones([1], (device, dtype));
    let mut ends = [0.0; 2];
    for time in 1..=STEPS + 1 {
        let leaves: Vec<Tensor<2>> = parameters
            .iter()
            .map(|parameter| {
                let value = Tensor::from_inner(parameter.value.clone());
                if parameter.attribute.learns() { value.require_grad() } else { value }
            })
            .collect();
        let surfels: Surfels = SurfelColumns::<()>::from_list(model, leaves[..count].to_vec());
        let gaussians: Gaussians = GaussianColumns::<()>::from_list(model, leaves[count..].to_vec());
        let rendered = render(&surfels, &gaussians, camera, &RenderOptions::default()).unwrap();
        let target = Tensor::from_inner(target.clone());
        let total = losses(&rendered, surfels.log_scales.clone(), target, &LossWeights::default()).unwrap().total;
        ends[usize::from(time > 1)] = values(&total)[0];
        let gradients = total.backward();
        for (parameter, leaf) in parameters.iter_mut().zip(&leaves) {
            let Some(gradient) = leaf.grad(&gradients) else { continue };
            let learning_rate = rate(parameter.attribute, case.extent, time);
            let step = AdamStep { learning_rate, beta_1: 0.9, beta_2: 0.999, epsilon: 1e-15, time };
            let (value, moments) = (parameter.value.clone(), parameter.moments.clone());
            (parameter.value, parameter.moments) = adam_step(value, moments, &gradient, &gate, &step).unwrap();
        }
    }
    ends
}

fn picture(scene: &TestScene, device: &Device, dtype: DType) -> Tensor<3> {
    let exact = ndarray();
    let (surfels, gaussians) = scene.tensors(&exact, DType::F64);
    let image = render(&surfels, &gaussians, &scene.camera, &RenderOptions::default()).unwrap().composite.image;
    let data = TensorData::new(values(&image), image.dims()).convert_dtype(dtype);
    Tensor::from_data(data, (device, dtype))
}

/// `device` in f32 against a CPU in f64.
pub fn training_in_f32_ends_where_it_ends_in_f64(device: &Device) {
    for seed in 0..SEEDS {
        for case in cases(seed) {
            let [start, exact] = train(&case, &ndarray(), DType::F64);
            let [_, found] = train(&case, device, DType::F32);
            let (name, apart) = (case.name, (found - exact).abs() / exact);
            println!("{name}, seed {seed}: from {start:.4} to {exact:.6} in f64, {found:.6} in f32, {apart:.1e} apart");
            assert!(exact < 0.9 * start, "{name}, seed {seed}: the loss went from {start} to {exact}");
            assert!(apart < TOLERANCE, "{name}, seed {seed}: {found} in f32 and {exact} in f64");
        }
    }
}
