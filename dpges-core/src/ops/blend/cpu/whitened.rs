//! Gaussians that rays meet in the frame in which they are spheres.

use pulp::Simd;

use super::projected::{CameraPair, Drawn, Group, Projected, Sums, add_depths};
use crate::backend::lanes::Lanes;
use crate::backend::real::Real;
use crate::camera::Camera;
use crate::footprint::gaussian::cpu::whitened::{self, SUMS, Whitened};
use crate::footprint::gaussian::cpu::{ParameterGrad, Parameters};
use crate::math::{CameraOf, V3};
use crate::tiles::{PixelRect, TileGrid};

/// A whitened Gaussian with the slopes of its centre, which the probe needs.
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
    fn draw<S: Simd>(&self, dx: Lanes<T, S>, dy: T) -> Option<Drawn<T, S>> {
        let (drawn, [weight, depth]) = self.shape.fragments(dx, dy);
        Drawn::new(drawn, weight, depth)
    }

    #[inline(always)]
    fn gather<S: Simd, const MAPS: bool>(&self, group: &Group<T, S>, sums: &mut Sums<Lanes<T, S>>) {
        let grad_depth = if MAPS { group.grad_depth } else { Lanes::zero(group.dx.simd()) };
        let grad = self.shape.pixel_backward(group.dx, group.dy, group.power, grad_depth);
        let numbers = grad.a.into_iter().chain(grad.b).chain(grad.z);
        let numbers = numbers.chain([grad.distance, grad.delta[0], grad.delta[1], group.power]);
        // what is not blended may be infinite
        for (sum, value) in sums.footprint.iter_mut().zip(numbers) {
            *sum = *sum + value.only(group.blended);
        }
        if let [x, y, z, size] = &mut *sums.probe {
            for (sum, value) in [x, y, z].into_iter().zip(self.shape.towards(&grad, self.slopes)) {
                let value = value.only(group.blended);
                *sum = *sum + value;
                *size = *size + value.abs();
            }
        }
        if MAPS {
            add_depths(sums.maps, grad.depth.only(group.blended));
        }
    }

    fn probe_units(_: &Camera) -> [T; 4] {
        // half the depth takes the place of half the image (HTGS)
        [T::of(0.5); 4]
    }

    fn backward(&self, view: &CameraPair<T>, parameters: &Parameters<T>, sums: &Sums<T>) -> ParameterGrad<T> {
        let grad_depth = sums.maps.last().copied().unwrap_or(T::zero());
        let footprint = std::array::from_fn(|i| sums.footprint[i]);
        whitened::backward(&view.camera, parameters, &self.shape, footprint, grad_depth)
    }
}
