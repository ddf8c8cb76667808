use super::*;
use crate::scene::schema::Columns;
use crate::scene::{ColourModel, GaussianData, SH_C0};
use crate::testing::device;
use crate::testing::golden::{gradient, values};
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

    fn with_column(&self, at: usize, values: &[f64]) -> Self {
        let mut numbers = self.clone();
        numbers.columns[at] = values.to_vec();
        numbers
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
    let view = ViewRequest { probe: Some(&probe), ..camera.into() };
    let view = render_summed(&gaussians, &common, view, &options(weight)).unwrap();
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

/// The images of golden cases tell what these should be.
#[test]
fn pictures_do_not_depend_on_an_order() {
    for (seed, weight) in (3..).zip(WEIGHTS) {
        let TestScene { gaussians, camera, .. } = scene(seed, 40, MODEL);
        let flat = |gaussians: &GaussianData| {
            let view = seen(&Numbers::new(gaussians, weight), &camera, weight).0;
            [&view.image, &view.alpha, view.depth.as_ref().unwrap()].into_iter().flat_map(values).collect::<Vec<f64>>()
        };
        let found = flat(&gaussians);
        assert!(found.iter().filter(|value| **value > 0.05).count() > found.len() / 4, "{weight:?}");
        let backwards: Vec<usize> = (0..gaussians.len()).rev().collect();
        for (found, reversed) in found.iter().zip(flat(&gaussians.select(&backwards))) {
            approx::assert_relative_eq!(*found, reversed, epsilon = 1e-12, max_relative = 1e-12);
        }
    }
}

#[test]
fn depth_is_what_colours_are_that_equal_depths() {
    for (seed, weight) in (3..).zip(WEIGHTS) {
        let TestScene { mut gaussians, camera, .. } = scene(seed, 40, MODEL);
        gaussians.colour.detail.fill(0.0);
        let colours = gaussians.colour.base.as_chunks_mut::<3>().0.iter_mut();
        for (colour, position) in colours.zip(gaussians.positions.as_chunks::<3>().0) {
            let depth = camera.depth(position.map(f64::from).into());
            colour.fill(((depth - 0.5) / SH_C0) as f32);
        }
        let view = seen(&Numbers::new(&gaussians, weight), &camera, weight).0;
        let (image, alphas) = (values(&view.image), values(&view.alpha));
        for ((depth, alpha), red) in values(&view.depth.unwrap()).into_iter().zip(alphas).zip(image) {
            let expected = red - (1.0 - alpha) * BACKGROUND[0];
            approx::assert_relative_eq!(depth, expected, epsilon = 1e-5, max_relative = 1e-5);
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
        let at = |numbers: &Numbers| values(&loss(&seen(numbers, &camera, weight).0))[0];
        for (i, (attribute, leaf)) in leaves.iter().enumerate() {
            // directions carry none
            if attribute.name == "gaussians.positions" {
                continue;
            }
            let (name, found) = (format!("{weight:?}, {}", attribute.name), gradient(leaf, &gradients));
            check(&name, &numbers.columns[i], &found, 1e-6, |moved| at(&numbers.with_column(i, moved)));
        }
        let of_common = [&common.sigma, &common.beta, &common.background];
        let found: Vec<f64> = of_common.into_iter().flat_map(|leaf| gradient(leaf, &gradients)).collect();
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
            values(&loss(&seen(&numbers.with_column(0, moved), &camera, weight).0))[0]
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
    let view = render_summed(&gaussians, &common, &camera, &options(DepthWeight::Linear));
    assert!(view.unwrap_err().to_string().contains("`harmonics base`"));
}
