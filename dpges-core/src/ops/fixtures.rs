//! Fixtures for tests of several operations and of losses.

use burn::tensor::{DType, Device, Int, Tensor, TensorData};
use glam::{DMat3, DVec3};

use crate::camera::{Camera, CameraFromWorld};
use crate::footprint::gaussian::cpu::Parameters;
use crate::ops::peel::Layers;
use crate::scene::{Colour, ColourModel, Gaussians, SurfelData};
use crate::testing::device;
use crate::testing::golden::values;
use crate::testing::gradients::{check, leaf};
use crate::testing::lenses::{behind, every_model};
use crate::testing::random::Random;
use crate::testing::scenes::{self, Recipe};

/// In the world's axes.
pub fn axis_camera() -> Camera {
    let pose = CameraFromWorld { rotation: DMat3::IDENTITY, translation: DVec3::ZERO };
    let (cx, cy, width, height) = (18.0, 14.0, 40, 30);
    Camera { camera_from_world: pose, fx: 40.0, fy: 44.0, cx, cy, width, height, near: 0.2, lens: None }
}

/// `camera` with a lens of every model; wide ones see 170° across its picture, and more in its corners.
pub fn cameras_with_lenses(camera: Camera) -> Vec<(&'static str, Camera)> {
    every_model().into_iter().map(|(name, lens)| (name, behind(camera, lens, 170.0))).collect()
}

pub fn of_type<const D: usize>(values: &[f64], shape: [usize; D], device: &Device, dtype: DType) -> Tensor<D> {
    Tensor::from_data(TensorData::new(values.to_vec(), shape).convert_dtype(dtype), (device, dtype))
}

/// An f64 tensor without gradient.
pub fn constant<const D: usize>(values: &[f64], shape: [usize; D]) -> Tensor<D> {
    leaf(values, shape, &device()).detach()
}

/// Random factors that make a loss out of an output.
pub fn weights<const D: usize>(seed: u64, shape: [usize; D]) -> Tensor<D> {
    constant(&Random::new(seed).numbers(shape.iter().product(), -1.0, 1.0), shape)
}

/// Layers [K, H, W] at depths that are their opacities.
pub fn layers(ids: &[i32], alpha: Tensor<3>) -> Layers {
    let ids = TensorData::new(ids.to_vec(), alpha.dims());
    Layers { ids: Tensor::<3, Int>::from_data(ids, (&device(), DType::I32)), depth: alpha.clone().detach(), alpha }
}

pub fn wide(rows: &[f32]) -> Vec<f64> {
    rows.iter().map(|&value| f64::from(value)).collect()
}

/// Names and widths of the attributes of [`surfel_rows`].
pub const SURFEL_NAMES: [&str; 3] = ["positions", "quaternions", "log_scales"];
pub const SURFEL_WIDTHS: [usize; 3] = [3, 4, 2];

pub fn surfel_rows(surfels: &SurfelData) -> [Vec<f64>; 3] {
    [wide(&surfels.positions), wide(&surfels.quaternions), wide(&surfels.log_scales)]
}

/// [N, width] leaves of `rows`.
pub fn leaves_of<const N: usize>(rows: &[Vec<f64>; N], widths: [usize; N], count: usize) -> [Tensor<2>; N] {
    std::array::from_fn(|i| leaf(&rows[i], [count, widths[i]], &device()))
}

/// `rows` with others at `i`.
pub fn replaced<const N: usize>(rows: &[Vec<f64>; N], i: usize, others: &[f64]) -> [Vec<f64>; N] {
    let mut rows = rows.clone();
    rows[i] = others.to_vec();
    rows
}

/// The gradient of a leaf, 0 where there is none.
pub fn gradient_of<const D: usize>(leaf: &Tensor<D>, gradients: &burn::tensor::Gradients) -> Vec<f64> {
    leaf.grad(gradients).map_or_else(|| vec![0.0; leaf.dims().iter().product()], |gradient| values(&gradient))
}

/// Compares the gradients of a `loss` with respect to the rows of `count` primitives, attribute by attribute, with central
/// differences. Returns them. The first call of `loss` is that which goes back.
pub fn check_rows<const N: usize>(
    of: &str,
    names: [&str; N],
    rows: &[Vec<f64>; N],
    widths: [usize; N],
    step: f64,
    loss: impl Fn(&[Tensor<2>; N]) -> Tensor<1>,
) -> [Vec<f64>; N] {
    let count = rows[0].len() / widths[0];
    let leaves = leaves_of(rows, widths, count);
    let gradients = loss(&leaves).backward();
    std::array::from_fn(|i| {
        let found = gradient_of(&leaves[i], &gradients);
        check(&format!("{of} with respect to {}", names[i]), &rows[i], &found, step, |moved| {
            values(&loss(&leaves_of(&replaced(rows, i, moved), widths, count)))[0]
        });
        found
    })
}

/// Compares numbers one by one.
pub fn assert_near(found: &[f64], expected: &[f64], tolerance: f64) {
    assert_eq!(found.len(), expected.len());
    for (found, expected) in found.iter().zip(expected) {
        approx::assert_relative_eq!(found, expected, epsilon = tolerance, max_relative = tolerance);
    }
}

/// Names and widths of the attributes of [`Flat`].
pub const NAMES: [&str; 5] = ["positions", "quaternions", "log_scales", "opacities", "colours"];
pub const WIDTHS: [usize; 5] = [3, 4, 3, 1, 3];

/// Positions, quaternions, log-scales, opacities and colours of Gaussians, row-major; then degrees of freedom, of students.
#[derive(Clone, Default)]
pub struct Flat(pub [Vec<f64>; 5], pub Vec<f64>);

impl Flat {
    pub fn random(seed: u64, gaussians: usize, [width, height]: [usize; 2]) -> (Self, Camera) {
        let scene = scenes::random(seed, &Recipe { surfels: 0, gaussians, width, height, ..Recipe::default() });
        let g = scene.gaussians;
        let colours = Random::new(seed).numbers(3 * g.len(), -0.3, 1.3);
        let parameters = [wide(&g.positions), wide(&g.quaternions), wide(&g.log_scales), wide(&g.opacities), colours];
        (Self(parameters, Vec::new()), scene.camera)
    }

    pub fn push_turned(
        &mut self,
        quaternion: [f64; 4],
        position: [f64; 3],
        log_scales: [f64; 3],
        opacity: f64,
        colour: [f64; 3],
    ) {
        let rows: [&[f64]; 5] = [&position, &quaternion, &log_scales, &[opacity], &colour];
        self.0.iter_mut().zip(rows).for_each(|(all, row)| all.extend(row));
    }

    pub fn len(&self) -> usize {
        self.0[3].len()
    }

    pub fn row<const W: usize>(&self, of: usize, i: usize) -> [f64; W] {
        self.0[of][W * i..W * (i + 1)].try_into().unwrap()
    }

    pub fn parameters(&self, i: usize) -> Parameters<f64> {
        Parameters {
            position: self.row(0, i),
            quaternion: self.row(1, i),
            log_scales: self.row(2, i),
            opacity: self.0[3][i],
            degrees_of_freedom: self.1.get(i).copied().unwrap_or(f64::INFINITY),
        }
    }

    /// Gaussians and their colours, leaves all.
    pub fn gaussians_on(&self, device: &Device, dtype: DType) -> (Gaussians, Tensor<2>) {
        let count = self.len();
        let column = |values: &[f64], width: usize| of_type(values, [count, width], device, dtype).require_grad();
        let rows = |i: usize| column(&self.0[i], WIDTHS[i]);
        let gaussians = Gaussians {
            positions: rows(0),
            quaternions: rows(1),
            log_scales: rows(2),
            opacities: rows(3),
            opacity_base: column(&[], 0),
            opacity_detail: column(&[], 0),
            colour: Colour::new(ColourModel::SphericalBeta { lobes: 0 }, rows(4), column(&[], 0)),
            degrees_of_freedom: (!self.1.is_empty()).then(|| column(&self.1, 1)),
        };
        (gaussians, rows(4))
    }

    pub fn gaussians(&self) -> (Gaussians, Tensor<2>) {
        self.gaussians_on(&device(), DType::F64)
    }
}
