//! Gaussians that rays meet in the frame in which they are spheres.

use super::projected::{CameraPair, Group, Projected, Sums, WORK_ROWS, thinnest_axis};
use crate::backend::real::Real;
use crate::backend::simd::LANES;
use crate::camera::Camera;
use crate::footprint::gaussian::cpu::whitened::{self, SUMS, Whitened};
use crate::footprint::gaussian::cpu::{ParameterGrad, Parameters};
use crate::math::{CameraOf, V3};
use crate::tiles::{PixelRect, TileGrid};

/// With the slopes of its centre, which the probe needs.
#[derive(Clone, Copy, Debug)]
pub struct WhitenedFootprint<T> {
    shape: Whitened<T>,
    slopes: [T; 2],
}

impl<T: Real> Projected<T> for WhitenedFootprint<T> {
    const SUMS: usize = SUMS;

    fn new(view: &CameraPair<T>, parameters: &Parameters<T>, colour: V3<T>) -> Option<Self> {
        let camera: &CameraOf<T> = &view.camera;
        Whitened::new(camera, parameters, colour).map(|shape| Self { shape, slopes: shape.slopes(camera) })
    }

    fn normal_axis(parameters: &Parameters<T>) -> usize {
        thinnest_axis(parameters)
    }

    #[inline(always)]
    fn colour(&self) -> V3<T> {
        self.shape.colour
    }

    fn centre_depth(&self) -> T {
        self.shape.depth
    }

    #[inline(always)]
    fn anchor(&self) -> [T; 2] {
        self.shape.mean
    }

    fn reach(&self, _: TileGrid) -> PixelRect {
        self.shape.reach()
    }

    #[inline(always)]
    fn touches(&self, _: usize, _: usize) -> bool {
        true
    }

    #[inline(always)]
    fn fragments(&self, dx: &[T; LANES], dy: T, weight: &mut [T; LANES], depth: &mut [T; LANES]) {
        self.shape.fragments(dx, dy, weight, depth);
    }

    #[inline(always)]
    fn gather<const MAPS: bool>(&self, group: &Group<T>, _: &mut [[T; LANES]; WORK_ROWS], sums: &mut Sums<[T; LANES]>) {
        for lane in 0..LANES {
            if group.covered[lane] == T::zero() && group.power[lane] == T::zero() {
                continue;
            }
            let grad_depth = if MAPS { group.grad_depth[lane] } else { T::zero() };
            let grad = self.shape.pixel_backward(group.dx[lane], group.dy, group.power[lane], grad_depth);
            let numbers = grad.a.into_iter().chain(grad.b).chain(grad.z);
            let numbers = numbers.chain([grad.distance, grad.delta[0], grad.delta[1], group.power[lane]]);
            for (sum, value) in sums.footprint.iter_mut().zip(numbers) {
                sum[lane] = sum[lane] + value;
            }
            if let [x, y, z, size] = &mut *sums.probe {
                let towards = self.shape.towards(&grad, self.slopes);
                for (sum, value) in [x, y, z].into_iter().zip(towards) {
                    sum[lane] = sum[lane] + value;
                }
                size[lane] = size[lane] + towards.into_iter().map(|value| value.abs()).sum::<T>();
            }
            if MAPS && let [.., of_depth] = &mut *sums.maps {
                of_depth[lane] = of_depth[lane] + grad.depth;
            }
        }
    }

    fn probe_units(_: &Camera) -> [T; 4] {
        [T::of(0.5); 4]
    }

    fn backward(&self, view: &CameraPair<T>, parameters: &Parameters<T>, sums: &Sums<T>) -> ParameterGrad<T> {
        let grad_depth = sums.maps.last().copied().unwrap_or(T::zero());
        let footprint = std::array::from_fn(|i| sums.footprint[i]);
        whitened::backward(&view.camera, parameters, &self.shape, footprint, grad_depth)
    }
}
