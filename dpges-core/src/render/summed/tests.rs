use burn::tensor::Gradients;

use super::*;
use crate::footprint::gaussian::cpu::{Parameters, Splat};
use crate::math::CameraOf;
use crate::scene::schema::Columns;
use crate::scene::{ColourModel, GaussianData};
use crate::testing::device;
use crate::testing::golden::values;
use crate::testing::gradients::{check, leaf};
use crate::testing::random::Random;
use crate::testing::scenes::{Recipe, TestScene, random};

const MODEL: ColourModel = ColourModel::HarmonicsAndOpacity { degree: 3 };
const WEIGHTS: [DepthWeight; 3] = [DepthWeight::Direct, DepthWeight::Exponential, DepthWeight::Linear];
const BACKGROUND: [f64; 3] = [0.1, 0.2, 0.3];

fn scene(seed: u64, gaussians: usize, model: ColourModel) -> TestScene {
    random(seed, &Recipe { surfels: 0, gaussians, model, width: 23, height: 17, ..Recipe::default() })
}

/// σ so that some Gaussians of a scene lie behind it, or weigh clearly less than others.
fn common_of(weight: DepthWeight) -> [f64; 3] {
    [if weight == DepthWeight::Exponential { 0.2 } else { 3.5 }, 1.3, 0.03]
}

/// Columns of Gaussians, then σ, β and w_b, as numbers.
#[derive(Clone)]
struct Numbers {
    columns: Vec<Vec<f64>>,
    common: [f64; 3],
}

impl Numbers {
    fn new(gaussians: &GaussianData, weight: DepthWeight) -> Self {
        let wide = |values: &Vec<f32>| values.iter().map(|&value| f64::from(value)).collect();
        Self { columns: gaussians.list().into_iter().map(wide).collect(), common: common_of(weight) }
    }

    fn leaves(&self, model: ColourModel) -> (Gaussians, WeightedSumTensors) {
        let count = self.columns[0].len() / 3;
        let columns = GaussianData::ATTRIBUTES.iter().zip(&self.columns);
        let columns = columns.map(|(attribute, values)| leaf(values, attribute.shape(count, model), &device()));
        let [sigma, beta, background] = self.common.map(|value| leaf(&[value], [1, 1], &device()));
        (Gaussians::generate(model, columns), WeightedSumTensors { sigma, beta, background })
    }
}

fn options(weight: DepthWeight) -> SummedOptions {
    SummedOptions { weight, background: BACKGROUND, depth: true }
}

fn seen(
    numbers: &Numbers,
    camera: &Camera,
    weight: DepthWeight,
) -> (SummedRender, Gaussians, WeightedSumTensors, Tensor<2>) {
    let (gaussians, common) = numbers.leaves(MODEL);
    let probe = leaf(&vec![0.0; 2 * gaussians.len()], [gaussians.len(), 2], &device());
    let probes = Probes { gaussians: Some(&probe), pose: None };
    let view = render_summed(&gaussians, &common, probes, camera, &options(weight), Values::Unknown).unwrap();
    (view, gaussians, common, probe)
}

fn loss(view: &SummedRender) -> Tensor<1> {
    let weighted =
        [&view.image, &view.alpha, view.depth.as_ref().unwrap()].into_iter().zip(1..).map(|(plane, seed)| {
            let shape = plane.dims();
            let weights = Random::new(seed).numbers(shape.iter().product(), -1.0, 1.0);
            (plane.clone() * leaf(&weights, shape, &device()).detach()).sum()
        });
    weighted.reduce(|sum, term| sum + term).unwrap()
}

/// Image, alpha and depth by the formula, one Gaussian and one pixel after the other.
fn densely(numbers: &Numbers, camera: &Camera, weight: DepthWeight) -> Vec<f64> {
    let (gaussians, _) = numbers.leaves(MODEL);
    let centre = camera.centre().to_array();
    let factor =
        values(&harmonics(&gaussians.opacity_base, &gaussians.opacity_detail, &gaussians.positions, centre).unwrap());
    let colours = values(&colour(&gaussians.colour, &gaussians.positions, centre).unwrap());
    let (of, [sigma, beta, of_background]) = (CameraOf::<f64>::new(camera), numbers.common);
    let row = |of: usize, i: usize, width: usize| &numbers.columns[of][i * width..][..width];
    let area = camera.width * camera.height;
    let mut sums = vec![[0.0; 5]; area];
    for i in 0..gaussians.len() {
        let position: [f64; 3] = row(0, i, 3).try_into().unwrap();
        let depth = camera.depth(position.into());
        let w = match weight {
            DepthWeight::Direct => 1.0,
            DepthWeight::Exponential => (-sigma * depth.max(1e-6).powf(beta)).exp(),
            DepthWeight::Linear => (1.0 - depth / sigma).max(0.0),
        };
        let parameters = Parameters {
            position,
            quaternion: row(1, i, 4).try_into().unwrap(),
            log_scales: row(2, i, 3).try_into().unwrap(),
            opacity: numbers.columns[3][i] * factor[i].max(0.0) * w,
            degrees_of_freedom: f64::INFINITY,
        };
        let Some(splat) = Splat::new(&of, &parameters, [0.0; 3], ScreenFilter::Plain) else { continue };
        for (at, sums) in sums.iter_mut().enumerate() {
            let dx = (at % camera.width) as f64 + 0.5 - splat.mean[0];
            let dy = (at / camera.width) as f64 + 0.5 - splat.mean[1];
            let [u, v] = splat.in_deviations(dx, dy);
            let alpha = splat.weight(u, v);
            let payload = [colours[3 * i], colours[3 * i + 1], colours[3 * i + 2]].map(|c| c.max(0.0));
            let payload = [payload[0], payload[1], payload[2], 1.0, depth];
            sums.iter_mut().zip(payload).for_each(|(sum, value)| *sum += alpha * value);
        }
    }
    let plane = |c: usize| {
        let background = BACKGROUND.get(c).map_or(0.0, |b| b * of_background);
        sums.iter().map(move |sums| (sums[c] + background) / (sums[3] + of_background)).collect::<Vec<f64>>()
    };
    (0..5).flat_map(plane).collect()
}

#[test]
fn pictures_are_weighted_means_in_any_order() {
    for (seed, weight) in (3..).zip(WEIGHTS) {
        let TestScene { gaussians, camera, .. } = scene(seed, 40, MODEL);
        let numbers = Numbers::new(&gaussians, weight);
        let flat = |view: &SummedRender| {
            let planes = [&view.image, &view.alpha, view.depth.as_ref().unwrap()];
            planes.into_iter().flat_map(values).collect::<Vec<f64>>()
        };
        let found = flat(&seen(&numbers, &camera, weight).0);
        let expected = densely(&numbers, &camera, weight);
        assert!(expected.iter().filter(|value| **value > 0.05).count() > expected.len() / 4, "{weight:?}");
        for (found, expected) in found.iter().zip(&expected) {
            approx::assert_relative_eq!(*found, *expected, epsilon = 1e-10, max_relative = 1e-10);
        }
        let backwards: Vec<usize> = (0..gaussians.len()).rev().collect();
        let reversed = flat(&seen(&Numbers::new(&gaussians.select(&backwards), weight), &camera, weight).0);
        for (found, reversed) in found.iter().zip(&reversed) {
            approx::assert_relative_eq!(*found, *reversed, epsilon = 1e-12, max_relative = 1e-12);
        }
    }
}

#[test]
fn gradients_of_everything_that_learns_are_central_differences() {
    for (seed, weight) in (20..).zip(WEIGHTS) {
        let TestScene { gaussians, camera, .. } = scene(seed, 9, MODEL);
        let numbers = Numbers::new(&gaussians, weight);
        let (view, leaves, common, _) = seen(&numbers, &camera, weight);
        let gradients = loss(&view).backward();
        let of = |leaf: &Tensor<2>, gradients: &Gradients| {
            leaf.grad(gradients).map_or_else(|| vec![0.0; leaf.dims().iter().product()], |gradient| values(&gradient))
        };
        let at = |numbers: &Numbers| values(&loss(&seen(numbers, &camera, weight).0))[0];
        for (i, (attribute, leaf)) in leaves.iter().enumerate() {
            // directions carry none
            if attribute.name == "gaussians.positions" {
                continue;
            }
            check(
                &format!("{weight:?}, {}", attribute.name),
                &numbers.columns[i],
                &of(leaf, &gradients),
                1e-6,
                |moved| {
                    let mut numbers = numbers.clone();
                    numbers.columns[i] = moved.to_vec();
                    at(&numbers)
                },
            );
        }
        let found: Vec<f64> = [&common.sigma, &common.beta, &common.background]
            .into_iter()
            .flat_map(|leaf| of(leaf, &gradients))
            .collect();
        let learns = [weight != DepthWeight::Direct, weight == DepthWeight::Exponential, true];
        assert_eq!([0, 1, 2].map(|i| found[i] != 0.0), learns, "{weight:?}: {found:?}");
        check(&format!("{weight:?}, common"), &numbers.common, &found, 1e-6, |moved| {
            at(&Numbers { common: moved.try_into().unwrap(), ..numbers.clone() })
        });
    }
}

/// Harmonics of degree 0 do not depend on the direction.
#[test]
fn gradients_of_positions_go_through_depths_too() {
    for (seed, weight) in (30..).zip(WEIGHTS) {
        let TestScene { mut gaussians, camera, .. } = scene(seed, 9, MODEL);
        gaussians.opacity_detail.fill(0.0);
        gaussians.colour.detail.fill(0.0);
        let numbers = Numbers::new(&gaussians, weight);
        let (view, leaves, ..) = seen(&numbers, &camera, weight);
        let found = values(&leaves.positions.grad(&loss(&view).backward()).unwrap());
        check(&format!("{weight:?}, positions"), &numbers.columns[0], &found, 1e-6, |moved| {
            let mut numbers = numbers.clone();
            numbers.columns[0] = moved.to_vec();
            values(&loss(&seen(&numbers, &camera, weight).0))[0]
        });
    }
}

#[test]
fn what_lies_beyond_sigma_or_faces_away_is_not_there_and_nothing_is_divided_by_zero() {
    let TestScene { mut gaussians, camera, .. } = scene(5, 30, MODEL);
    let image = |gaussians: &GaussianData, common: [f64; 3]| {
        let numbers = Numbers { common, ..Numbers::new(gaussians, DepthWeight::Linear) };
        values(&seen(&numbers, &camera, DepthWeight::Linear).0.image)
    };
    let is_background = |image: Vec<f64>| {
        let area = image.len() / 3;
        image.iter().enumerate().all(|(at, value)| (value - BACKGROUND[at / area]).abs() < 1e-12)
    };
    assert!(!is_background(image(&gaussians, [10.0, 1.0, 0.02])));
    assert!(is_background(image(&gaussians, [1e-3, 1.0, 0.02])));
    for of_background in [0.0, -1.0, 1e-4] {
        assert_eq!(image(&gaussians, [10.0, 1.0, of_background]), image(&gaussians, [10.0, 1.0, 1e-4]));
    }
    gaussians.opacity_base.fill(-50.0);
    assert!(is_background(image(&gaussians, [10.0, 1.0, 0.02])));
    assert!(is_background(image(&gaussians.select(&[]), [10.0, 1.0, 0.02])));
}

#[test]
fn other_scenes_are_refused() {
    let info = SceneInfo::default();
    let error = SummedOptions::new(&info).unwrap_err().to_string();
    assert!(error.contains("rendering") && error.contains("peeled"), "{error}");
    let TestScene { gaussians, camera, .. } = scene(6, 3, ColourModel::SphericalHarmonics { degree: 1 });
    let gaussians = Gaussians::from_data(&gaussians, &device(), DType::F64);
    let common = WeightedSumTensors::new(&WeightedSum::default(), &device(), DType::F64);
    let view =
        render_summed(&gaussians, &common, Probes::default(), &camera, &options(DepthWeight::Linear), Values::Unknown);
    assert!(view.unwrap_err().to_string().contains("`harmonics base`"));
}
