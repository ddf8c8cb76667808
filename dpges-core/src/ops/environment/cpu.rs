//! CPU kernels: one task per band of image rows.

use burn::backend::TensorMetadata;
use burn::backend::tensor::FloatTensor;
use rayon::prelude::*;

use super::{EnvironmentBackwardOps, EnvironmentOps, PixelRays};
use crate::host::{self, Host, for_each_cpu_backend, with_real};
use crate::math::{M3, V3, apply, dot, scale};
use crate::ops::colour::cpu::model::harmonics;
use crate::real::Real;
use crate::scene::{EnvironmentData, SH_C0};
use crate::tiles::bands::{BAND_COUNT, Bands};

/// Y0 … Y15.
const MAX_COEFFICIENTS: usize = EnvironmentData::coefficient_count(EnvironmentData::MAX_DEGREE);

/// Values of all harmonics along the ray through the pixel at a position within a plane.
#[inline(always)]
fn basis<T: Real>(world_from_pixel: &M3<T>, at: usize, width: usize) -> [T; MAX_COEFFICIENTS] {
    let half = T::of(0.5);
    let pixel = [T::of((at % width) as f64) + half, T::of((at / width) as f64) + half, T::one()];
    let ray: V3<T> = apply(world_from_pixel, pixel);
    let higher = harmonics(scale(ray, T::one() / dot(ray, ray).sqrt()));
    std::array::from_fn(|k| if k == 0 { T::of(SH_C0) } else { higher[k - 1] })
}

fn forward<T: Real>(coefficients: &[T], rays: &PixelRays) -> Vec<T> {
    let PixelRays { width, height, .. } = *rays;
    let world_from_pixel = rays.world_from_pixel.map(|row| row.map(T::of));
    let bands = Bands::new(height);
    let mut image = vec![T::zero(); 3 * width * height];
    bands.split(&mut image, width).into_par_iter().enumerate().for_each(|(band, mut planes)| {
        for (local, at) in bands.pixels(band, width).enumerate() {
            let values = basis(&world_from_pixel, at, width);
            for (c, plane) in planes.iter_mut().enumerate() {
                plane[local] = coefficients.chunks_exact(3).zip(values).map(|(k, y)| k[c] * y).sum();
            }
        }
    });
    image
}

/// Gradient with respect to the first `count` coefficients.
fn backward<T: Real>(grad: &[T], rays: &PixelRays, count: usize) -> Vec<T> {
    let PixelRays { width, height, .. } = *rays;
    let world_from_pixel = rays.world_from_pixel.map(|row| row.map(T::of));
    let (bands, plane) = (Bands::new(height), width * height);
    let partial: Vec<[V3<T>; MAX_COEFFICIENTS]> = (0..BAND_COUNT)
        .into_par_iter()
        .map(|band| {
            let mut sums = [[T::zero(); 3]; MAX_COEFFICIENTS];
            for at in bands.pixels(band, width) {
                let incoming: V3<T> = std::array::from_fn(|c| grad[c * plane + at]);
                // hidden behind surfels
                if incoming == [T::zero(); 3] {
                    continue;
                }
                for (sum, y) in sums.iter_mut().zip(basis(&world_from_pixel, at, width)) {
                    *sum = std::array::from_fn(|c| sum[c] + incoming[c] * y);
                }
            }
            sums
        })
        .collect();
    (0..3 * count).map(|i| partial.iter().map(|sums| sums[i / 3][i % 3]).sum()).collect()
}

fn environment_on<B: Host>(coefficients: &FloatTensor<B>, rays: &PixelRays) -> FloatTensor<B> {
    with_real!(coefficients.dtype(), T => {
        let image = forward::<T>(&host::floats::<B, T>(coefficients), rays);
        host::float_tensor::<B, T, 3>(image, [3, rays.height, rays.width], &coefficients.device())
    })
}

fn environment_backward_on<B: Host>(grad: &FloatTensor<B>, rays: &PixelRays, count: usize) -> FloatTensor<B> {
    with_real!(grad.dtype(), T => {
        let coefficients = backward::<T>(&host::floats::<B, T>(grad), rays, count);
        host::float_tensor::<B, T, 2>(coefficients, [count, 3], &grad.device())
    })
}

macro_rules! implement {
    ($backend:ty) => {
        impl EnvironmentOps for $backend {
            fn environment(coefficients: FloatTensor<Self>, rays: PixelRays) -> FloatTensor<Self> {
                environment_on::<Self>(&coefficients, &rays)
            }
        }

        impl EnvironmentBackwardOps for $backend {
            fn environment_backward(grad: FloatTensor<Self>, rays: PixelRays, count: usize) -> FloatTensor<Self> {
                environment_backward_on::<Self>(&grad, &rays, count)
            }
        }
    };
}
for_each_cpu_backend!(implement);
