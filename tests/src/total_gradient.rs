//! The gradient of the whole loss, from parameters through rendering and every term, against
//! central differences in f64.

use burn::tensor::{DType, Device, Gradients, Tensor, TensorData};
use dpges_core::camera::Camera;
use dpges_core::losses::{self, LossWeights, losses};
use dpges_core::ops::peel::PeelOptions;
use dpges_core::ops::scale_loss::LINEAR_FROM;
use dpges_core::render::{RenderOptions, render};
use dpges_core::scene::schema::{Attribute, Columns, GaussianColumns, RateGroup, SurfelColumns};
use dpges_core::scene::{ColourModel, Footprint, Gaussians, Peeling, Surfels};
use dpges_core::testing::golden::values;
use dpges_core::testing::gradients::{check, check_elements, leaf};
use dpges_core::testing::random::Random;
use dpges_core::testing::scenes::{self, Recipe};

use crate::devices::flex;

/// Attributes that learn, those of surfels first.
fn learning() -> Vec<&'static Attribute> {
    let all = SurfelColumns::<()>::ATTRIBUTES.iter().chain(GaussianColumns::<()>::ATTRIBUTES);
    all.filter(|attribute| attribute.learns() && !attribute.is_left_out(LOBES)).collect()
}

const LOBES: ColourModel = ColourModel::SphericalBeta { lobes: 2 };
/// The direction of view carries no gradient to positions: they are checked where colour does not depend on it.
const CONSTANT: ColourModel = ColourModel::SphericalBeta { lobes: 0 };
const RECIPE: Recipe = Recipe { surfels: 14, gaussians: 16, model: LOBES, extent: 1.0, width: 27, height: 19 };

/// A scene in f64 and the image it should become.
#[derive(Clone)]
struct Wide {
    surfels: SurfelColumns<Vec<f64>>,
    gaussians: GaussianColumns<Vec<f64>>,
    target: Vec<f64>,
    camera: Camera,
}

struct Inputs {
    surfels: Surfels,
    gaussians: Gaussians,
}

impl Inputs {
    fn gradient(&self, of: &Attribute, gradients: &Gradients) -> Vec<f64> {
        let mut all = self.surfels.iter().chain(self.gaussians.iter());
        let (_, tensor) = all.find(|(attribute, _)| *attribute == of).unwrap();
        values(&tensor.grad(gradients).unwrap())
    }
}

impl Wide {
    fn new(seed: u64, model: ColourModel) -> Self {
        let scene = scenes::random(seed, &Recipe { model, ..RECIPE });
        let wide = |_: &Attribute, rows: Vec<f32>| rows.into_iter().map(f64::from).collect();
        Self {
            surfels: scene.surfels.map(wide),
            gaussians: scene.gaussians.map(wide),
            target: Random::new(seed).numbers(3 * RECIPE.width * RECIPE.height, 0.0, 1.0),
            camera: scene.camera,
        }
    }

    fn values_mut(&mut self, of: &Attribute) -> &mut Vec<f64> {
        let attributes = SurfelColumns::<()>::ATTRIBUTES.iter().chain(GaussianColumns::<()>::ATTRIBUTES);
        let mut all = attributes.zip(self.surfels.list_mut().into_iter().chain(self.gaussians.list_mut()));
        all.find(|(attribute, _)| *attribute == of).unwrap().1
    }

    fn inputs(&self, device: &Device) -> Inputs {
        let tensors = |count: usize, model: ColourModel| {
            move |attribute: &'static Attribute, rows: &Vec<f64>| {
                let data = TensorData::new(rows.clone(), attribute.shape(count, model));
                let tensor = Tensor::<2>::from_data(data, (device, DType::F64));
                if device.is_autodiff() && attribute.learns() { tensor.require_grad() } else { tensor }
            }
        };
        Inputs {
            surfels: self.surfels.map_ref(tensors(RECIPE.surfels, self.surfels.model())),
            gaussians: self.gaussians.map_ref(tensors(RECIPE.gaussians, self.gaussians.model())),
        }
    }

    fn loss(&self, inputs: &Inputs, peel: PeelOptions, detach_transmittance: bool) -> Tensor<1> {
        let background = [0.3, 0.1, 0.7];
        let options = RenderOptions { peel, background, detach_transmittance };
        let rendered = render(&inputs.surfels, &inputs.gaussians, &self.camera, &options).unwrap();
        let shape = rendered.composite.image.dims();
        let device = inputs.surfels.positions.device();
        let target = Tensor::from_data(TensorData::new(self.target.clone(), shape), (&device, DType::F64));
        // every term large enough to be seen, but for the scale loss: its mean carries no gradient
        let weights = LossWeights { dssim: 0.3, surfel: 0.4, scale: 0.0, transmittance: 0.5 };
        let every_third = (0..RECIPE.width * RECIPE.height).map(|pixel| f64::from(u8::from(pixel % 3 == 0))).collect();
        let mask = TensorData::new::<f64, _>(every_third, [1, RECIPE.height, RECIPE.width]);
        let hidden = losses::hidden(&rendered, Tensor::from_data(mask, (&device, DType::F64)));
        losses(&rendered, inputs.surfels.log_scales.clone(), target, &weights).unwrap().total + hidden * 0.6
    }
}

fn peel(layer_count: usize) -> PeelOptions {
    // rims wide enough for many layers to be translucent
    let (modulation, footprint) =
        if layer_count.is_multiple_of(2) { (0.9, Footprint::Opacity) } else { (30.0, Footprint::Kernel) };
    PeelOptions { layer_count, modulation, footprint, peeling: Peeling::Continuous }
}

#[test]
fn the_gradient_of_the_total_loss_is_central_differences() {
    for layer_count in 1..=4 {
        for attribute in learning() {
            let model = if attribute.rate == RateGroup::Positions { CONSTANT } else { LOBES };
            let mut scene = Wide::new(40 + layer_count as u64, model);
            // without ramps, whose ends move with the layers and carry no gradient
            scene.surfels.margins.fill(0.0);
            let inputs = scene.inputs(&flex().autodiff());
            let gradients = scene.loss(&inputs, peel(layer_count), false).backward();
            let found = inputs.gradient(attribute, &gradients);
            let elements: Vec<usize> = (0..found.len()).step_by(1 + found.len() / 24).collect();
            let name = format!("{} (K = {layer_count})", attribute.name);
            let at = scene.values_mut(attribute).clone();
            check_elements(&name, &at, &found, &elements, 2e-6, |moved| {
                let mut scene = scene.clone();
                *scene.values_mut(attribute) = moved.to_vec();
                values(&scene.loss(&scene.inputs(&flex()), peel(layer_count), false))[0]
            });
        }
    }
}

/// The paper's gradient from the Gaussians to the surfels is what the ablation takes away, and all it takes away.
#[test]
fn detaching_transmittance_changes_only_the_geometry_of_surfels() {
    for layer_count in 1..=4 {
        let scene = Wide::new(40 + layer_count as u64, LOBES);
        let gradients = [false, true].map(|detach| {
            let inputs = scene.inputs(&flex().autodiff());
            let gradients = scene.loss(&inputs, peel(layer_count), detach).backward();
            learning().into_iter().map(|attribute| inputs.gradient(attribute, &gradients)).collect::<Vec<_>>()
        });
        for (attribute, (full, detached)) in learning().into_iter().zip(gradients[0].iter().zip(&gradients[1])) {
            let is_geometry =
                ["surfels.positions", "surfels.quaternions", "surfels.log_scales"].contains(&attribute.name);
            // The first interval lies in front of all layers: with one layer nothing passes through.
            let expected = !is_geometry || layer_count == 1;
            assert_eq!(full == detached, expected, "{} (K = {layer_count})", attribute.name);
        }
    }
}

#[test]
fn the_gradient_of_the_scale_loss_is_central_differences_about_a_fixed_mean() {
    // the last surfel is so large that its exponential is continued by a tangent
    let mut log_scales = Random::new(1).numbers(2 * 40, -2.0, 0.0);
    log_scales.extend([3.5, 3.0]);
    let mean = log_scales.iter().map(|s| s.exp()).sum::<f64>() / log_scales.len() as f64;
    let of_surfel = |s: &[f64]| {
        let x = (s[0].exp() + s[1].exp()) / 2.0 / mean;
        if x < LINEAR_FROM { x.exp() } else { 20f64.exp() * (x - 19.0) }
    };
    let plainly = |s: &[f64]| s.chunks(2).map(of_surfel).sum::<f64>() / (s.len() / 2) as f64;
    assert!((3.5f64.exp() + 3f64.exp()) / 2.0 / mean > 20.0);
    let tensor = leaf(&log_scales, [41, 2], &flex().autodiff());
    let loss = losses::scale(tensor.clone());
    approx::assert_relative_eq!(values(&loss)[0], plainly(&log_scales), max_relative = 1e-12);
    let gradient = values(&tensor.grad(&loss.backward()).unwrap());
    let (rest, last) = gradient.split_at(80);
    // apart, since the huge one drowns the others
    check("scale loss, ordinary surfels", &log_scales[..80], rest, 1e-5, |moved| {
        moved.chunks(2).map(of_surfel).sum::<f64>() / 41.0
    });
    check("scale loss, huge surfel", &log_scales[80..], last, 1e-5, |moved| of_surfel(moved) / 41.0);
}

/// Surfels that no view sees shrink until their scales, exponentiated, are 0 or, growing, infinite.
#[test]
fn the_scale_loss_depends_on_ratios_only() {
    let log_scales = Random::new(2).numbers(2 * 10, -1.0, 1.0);
    let [plain, small, large] = [0.0, -900.0, 900.0].map(|shift| {
        let shifted: Vec<f64> = log_scales.iter().map(|s| s + shift).collect();
        let tensor = leaf(&shifted, [10, 2], &flex().autodiff());
        let loss = losses::scale(tensor.clone());
        [values(&loss), values(&tensor.grad(&loss.backward()).unwrap())].concat()
    });
    for shifted in [small, large] {
        approx::assert_relative_eq!(shifted.as_slice(), plain.as_slice(), max_relative = 1e-9);
    }
}
