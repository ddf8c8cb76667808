//! The gradient of the whole loss, from parameters through rendering and every term, against
//! central differences in f64.

use burn::tensor::{DType, Device, Gradients, Tensor, TensorData};
use dpges_core::camera::Camera;
use dpges_core::losses::{self, LossWeights, losses};
use dpges_core::ops::peel::PeelOptions;
use dpges_core::render::{RenderOptions, render};
use dpges_core::scene::{Colour, ColourModel, Footprint, Gaussians, Surfels};
use dpges_core::testing::golden::values;
use dpges_core::testing::gradients::{check, check_elements, leaf};
use dpges_core::testing::random::Random;
use dpges_core::testing::scenes::{self, Recipe};

use crate::devices::flex;

const NAMES: [&str; 11] = [
    "surfels.positions",
    "surfels.quaternions",
    "surfels.log_scales",
    "surfels.colour.base",
    "surfels.colour.detail",
    "gaussians.positions",
    "gaussians.quaternions",
    "gaussians.log_scales",
    "gaussians.colour.base",
    "gaussians.colour.detail",
    "gaussians.opacities",
];
const SURFEL_TENSORS: usize = 5;
const LOBES: ColourModel = ColourModel::SphericalBeta { lobes: 2 };
/// The direction of view carries no gradient to positions: they are checked where colour does not depend on it.
const CONSTANT: ColourModel = ColourModel::SphericalBeta { lobes: 0 };
const RECIPE: Recipe = Recipe { surfels: 14, gaussians: 16, model: LOBES, extent: 1.0, width: 27, height: 19 };

/// A scene in f64, in the order of [`NAMES`], and the image it should become.
#[derive(Clone)]
struct Flat {
    values: [Vec<f64>; 11],
    margins: Vec<f64>,
    target: Vec<f64>,
    camera: Camera,
    model: ColourModel,
}

struct Inputs {
    surfels: Surfels,
    gaussians: Gaussians,
}

impl Inputs {
    fn gradient(&self, which: usize, gradients: &Gradients) -> Vec<f64> {
        let (s, g) = (&self.surfels, &self.gaussians);
        let rows = [
            &s.positions,
            &s.quaternions,
            &s.log_scales,
            &s.colour.base,
            &s.colour.detail,
            &g.positions,
            &g.quaternions,
            &g.log_scales,
            &g.colour.base,
            &g.colour.detail,
        ];
        match rows.get(which) {
            Some(tensor) => values(&tensor.grad(gradients).unwrap()),
            None => values(&g.opacities.grad(gradients).unwrap()),
        }
    }
}

impl Flat {
    fn new(seed: u64, model: ColourModel) -> Self {
        let scene = scenes::random(seed, &Recipe { model, ..RECIPE });
        let (s, g) = (scene.surfels, scene.gaussians);
        let rows = [
            s.positions,
            s.quaternions,
            s.log_scales,
            s.colour.base,
            s.colour.detail,
            g.positions,
            g.quaternions,
            g.log_scales,
            g.colour.base,
            g.colour.detail,
            g.opacities,
        ];
        Self {
            values: rows.map(|rows| rows.into_iter().map(f64::from).collect()),
            margins: s.margins.into_iter().map(f64::from).collect(),
            target: Random::new(seed).numbers(3 * RECIPE.width * RECIPE.height, 0.0, 1.0),
            camera: scene.camera,
            model,
        }
    }

    fn inputs(&self, device: &Device) -> Inputs {
        let tensor = |rows: &[f64], count: usize| {
            let data = TensorData::new(rows.to_vec(), [count, rows.len() / count]);
            let tensor = Tensor::<2>::from_data(data, (device, DType::F64));
            if device.is_autodiff() { tensor.require_grad() } else { tensor }
        };
        let (n, m) = (RECIPE.surfels, RECIPE.gaussians);
        let [sp, sq, ss, sb, sd, gp, gq, gs, gb, gd, go] = &self.values;
        let colour = |base: &[f64], detail: &[f64], count| Colour {
            model: self.model,
            base: tensor(base, count),
            detail: tensor(detail, count),
        };
        let column = |values: &[f64]| {
            Tensor::<1>::from_data(TensorData::new(values.to_vec(), [values.len()]), (device, DType::F64))
        };
        let opacities = column(go);
        let opacities = if device.is_autodiff() { opacities.require_grad() } else { opacities };
        Inputs {
            surfels: Surfels {
                positions: tensor(sp, n),
                quaternions: tensor(sq, n),
                log_scales: tensor(ss, n),
                colour: colour(sb, sd, n),
                margins: column(&self.margins),
            },
            gaussians: Gaussians {
                positions: tensor(gp, m),
                quaternions: tensor(gq, m),
                log_scales: tensor(gs, m),
                opacities,
                colour: colour(gb, gd, m),
            },
        }
    }

    fn loss(&self, inputs: &Inputs, peel: PeelOptions, detach_transmittance: bool) -> Tensor<1> {
        let background = [0.3, 0.1, 0.7];
        let options = RenderOptions { peel, background, detach_transmittance, ..RenderOptions::default() };
        let rendered = render(&inputs.surfels, &inputs.gaussians, &self.camera, &options).unwrap();
        let shape = rendered.composite.image.dims();
        let device = inputs.surfels.positions.device();
        let target = Tensor::from_data(TensorData::new(self.target.clone(), shape), (&device, DType::F64));
        // every term large enough to be seen, but for the scale loss: its mean carries no gradient
        let weights = LossWeights { dssim: 0.3, surfel: 0.4, scale: 0.0, transmittance: 0.5 };
        losses(&rendered, inputs.surfels.log_scales.clone(), target, &weights).unwrap().total
    }
}

fn peel(layer_count: usize) -> PeelOptions {
    // rims wide enough for many layers to be translucent
    let (modulation, footprint) =
        if layer_count.is_multiple_of(2) { (0.9, Footprint::Opacity) } else { (30.0, Footprint::Kernel) };
    PeelOptions { layer_count, modulation, footprint }
}

#[test]
fn the_gradient_of_the_total_loss_is_central_differences() {
    for layer_count in 1..=4 {
        for (which, name) in NAMES.iter().enumerate() {
            let model = if name.ends_with("positions") { CONSTANT } else { LOBES };
            let flat = Flat::new(40 + layer_count as u64, model);
            let inputs = flat.inputs(&flex().autodiff());
            let gradients = flat.loss(&inputs, peel(layer_count), false).backward();
            let found = inputs.gradient(which, &gradients);
            let elements: Vec<usize> = (0..found.len()).step_by(1 + found.len() / 24).collect();
            let name = format!("{name} (K = {layer_count})");
            check_elements(&name, &flat.values[which], &found, &elements, 2e-6, |moved| {
                let mut flat = flat.clone();
                flat.values[which] = moved.to_vec();
                values(&flat.loss(&flat.inputs(&flex()), peel(layer_count), false))[0]
            });
        }
    }
}

/// The paper's gradient from the Gaussians to the surfels is what the ablation takes away, and all it takes away.
#[test]
fn detaching_transmittance_changes_only_the_geometry_of_surfels() {
    for layer_count in 1..=4 {
        let flat = Flat::new(40 + layer_count as u64, LOBES);
        let gradients = [false, true].map(|detach| {
            let inputs = flat.inputs(&flex().autodiff());
            let gradients = flat.loss(&inputs, peel(layer_count), detach).backward();
            [0; NAMES.len()].iter().enumerate().map(|(i, _)| inputs.gradient(i, &gradients)).collect::<Vec<_>>()
        });
        for (which, name) in NAMES.iter().enumerate() {
            let same = gradients[0][which] == gradients[1][which];
            // the first interval lies in front of all layers: with one layer nothing passes through
            let expected = which >= SURFEL_TENSORS || which >= 3 || layer_count == 1;
            assert_eq!(same, expected, "{name} (K = {layer_count})");
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
        if x < losses::SCALE_LOSS_LINEAR_FROM { x.exp() } else { 20f64.exp() * (x - 19.0) }
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
