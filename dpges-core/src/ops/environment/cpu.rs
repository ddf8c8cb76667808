//! CPU kernels: one task per band of image rows, several pixels at a time.

use burn::backend::TensorMetadata;
use burn::backend::tensor::FloatTensor;
use rayon::prelude::*;

use super::EnvironmentOps;
use super::autodiff::EnvironmentState;
use crate::backend::host::{self, Host, with_real};
use crate::backend::real::Real;
use crate::backend::tape::BackwardState;
use crate::backend::vectorised::vectorised;
use crate::camera::Camera;
use crate::footprint::rays::{Rays, rays};
use crate::math::{CameraOf, M3, V3, apply, apply_transposed, dot, scale};
use crate::ops::colour::cpu::model::harmonics;
use crate::scene::{EnvironmentData, SH_C0};
use crate::tiles::bands::{BAND_COUNT, Bands};

/// Pixels that are processed together.
const LANES: usize = 8;
/// Y0 … Y15.
const MAX_COEFFICIENTS: usize = EnvironmentData::coefficient_count(EnvironmentData::MAX_DEGREE);

/// Vectors along the rays of pixels, in world axes.
enum Directions<T> {
    /// A matrix by rows, applied to (x, y, 1), px.
    Linear(M3<T>),
    /// Rays in camera axes, with the rotation of the camera.
    Bent { rays: Rays, camera_from_world: M3<T>, width: usize },
}

impl<T: Real> Directions<T> {
    fn new(camera: &Camera) -> Self {
        match rays(camera) {
            None => {
                let world_from_pixel = camera.world_from_pixel().transpose().to_cols_array_2d();
                Self::Linear(world_from_pixel.map(|row| row.map(T::of)))
            }
            Some(rays) => Self::Bent { rays, camera_from_world: CameraOf::new(camera).rotation, width: camera.width },
        }
    }

    /// Rays of [`LANES`] pixels of row `y`, from column `x` on; 0 where there is no ray.
    #[inline(always)]
    fn of(&self, x: usize, y: usize) -> [V3<T>; LANES] {
        let half = T::of(0.5);
        let (left, row) = (T::of(x as f64) + half, T::of(y as f64) + half);
        match self {
            Self::Linear(world_from_pixel) => {
                std::array::from_fn(|lane| apply(world_from_pixel, [left + T::of(lane as f64), row, T::one()]))
            }
            Self::Bent { rays, camera_from_world, width } => std::array::from_fn(|lane| {
                // lanes beyond the row repeat its last pixel; what they find is dropped
                let at = y * width + (x + lane).min(width - 1);
                apply_transposed(camera_from_world, rays[at].map(T::of))
            }),
        }
    }
}

/// Values of all harmonics along the rays through [`LANES`] pixels of row `y`, from column `x` on.
#[inline(always)]
fn basis<T: Real>(directions: &Directions<T>, x: usize, y: usize) -> [[T; LANES]; MAX_COEFFICIENTS] {
    let rays = directions.of(x, y);
    let mut values = [[T::of(SH_C0); LANES]; MAX_COEFFICIENTS];
    for (lane, &ray) in rays.iter().enumerate() {
        let higher = harmonics(scale(ray, T::one() / dot(ray, ray).sqrt()));
        for (values, y) in values[1..].iter_mut().zip(higher) {
            values[lane] = y;
        }
    }
    if matches!(directions, Directions::Bent { .. }) {
        // a ray of 0 has no direction, and its harmonics are NaN until here
        for (lane, ray) in rays.iter().enumerate() {
            if *ray == [T::zero(); 3] {
                values.iter_mut().for_each(|values| values[lane] = T::zero());
            }
        }
    }
    values
}

fn forward<T: Real>(coefficients: &[T], camera: &Camera) -> Vec<T> {
    let Camera { width, height, .. } = *camera;
    let directions = Directions::<T>::new(camera);
    let bands = Bands::new(height);
    let mut image = vec![T::zero(); 3 * width * height];
    bands.split(&mut image, width).into_par_iter().enumerate().for_each(|(band, mut planes)| {
        vectorised(|| {
            for (local, y) in bands.rows(band).enumerate() {
                for x in (0..width).step_by(LANES) {
                    let values = basis(&directions, x, y);
                    let (at, count) = (local * width + x, LANES.min(width - x));
                    for (c, plane) in planes.iter_mut().enumerate() {
                        let mut sum = [T::zero(); LANES];
                        for (k, values) in coefficients.chunks_exact(3).zip(&values) {
                            sum = std::array::from_fn(|lane| sum[lane] + k[c] * values[lane]);
                        }
                        plane[at..at + count].copy_from_slice(&sum[..count]);
                    }
                }
            }
        });
    });
    image
}

/// Gradient with respect to the first `count` coefficients.
fn backward<T: Real>(grad: &[T], camera: &Camera, count: usize) -> Vec<T> {
    let Camera { width, height, .. } = *camera;
    let directions = Directions::<T>::new(camera);
    let (bands, plane) = (Bands::new(height), width * height);
    let none = [T::zero(); LANES];
    // sums by bands and lanes, added in this order: the same bits with any number of threads
    let partial: Vec<[[[T; LANES]; 3]; MAX_COEFFICIENTS]> = (0..BAND_COUNT)
        .into_par_iter()
        .map(|band| {
            let mut sums = [[none; 3]; MAX_COEFFICIENTS];
            vectorised(|| {
                for y in bands.rows(band) {
                    for x in (0..width).step_by(LANES) {
                        let (at, present) = (y * width + x, LANES.min(width - x));
                        let mut incoming = [none; 3];
                        for (c, incoming) in incoming.iter_mut().enumerate() {
                            incoming[..present].copy_from_slice(&grad[c * plane + at..][..present]);
                        }
                        // hidden behind surfels
                        if incoming == [none; 3] {
                            continue;
                        }
                        for (sum, values) in sums[..count].iter_mut().zip(basis(&directions, x, y)) {
                            for (sum, incoming) in sum.iter_mut().zip(&incoming) {
                                *sum = std::array::from_fn(|lane| sum[lane] + incoming[lane] * values[lane]);
                            }
                        }
                    }
                }
            });
            sums
        })
        .collect();
    let total = |i: usize| partial.iter().flat_map(|sums| sums[i / 3][i % 3]).sum();
    (0..3 * count).map(total).collect()
}

impl<B: Host> EnvironmentOps for B {
    fn environment(coefficients: FloatTensor<B>, camera: Camera) -> FloatTensor<B> {
        with_real!(coefficients.dtype(), T => {
            let image = forward::<T>(&host::floats::<B, T>(&coefficients), &camera);
            host::float_tensor::<B, T, 3>(image, [3, camera.height, camera.width], &coefficients.device())
        })
    }
}

impl<B: Host> BackwardState<B, 1> for EnvironmentState {
    fn backward(self, grad: FloatTensor<B>) -> [Option<FloatTensor<B>>; 1] {
        with_real!(grad.dtype(), T => {
            let coefficients = backward::<T>(&host::floats::<B, T>(&grad), &self.camera, self.count);
            [Some(host::float_tensor::<B, T, 2>(coefficients, [self.count, 3], &grad.device()))]
        })
    }
}
