//! Ellipses with kernels of Student's t distribution.

use pulp::Simd;

use super::projected::{CameraPair, Drawn, Group, Projected, Sums, add_depths, add_to_ellipse};
use crate::backend::lanes::Lanes;
use crate::backend::real::Real;
use crate::footprint::gaussian::cpu::student::{self, Student};
use crate::footprint::gaussian::cpu::{ParameterGrad, Parameters};
use crate::footprint::moments::MOMENTS;
use crate::math::V3;
use crate::tiles::{PixelRect, TileGrid};

impl<T: Real> Projected<T> for Student<T> {
    /// The moments of the gradient of r² times −2, the gradient of the exponent, that of ν.
    const SUMS: usize = MOMENTS + 2;
    const HAS_DEGREES: bool = true;

    fn new(view: &CameraPair<T>, parameters: &Parameters<T>, colour: V3<T>) -> Option<Self> {
        Self::new(&view.camera, parameters, colour)
    }

    #[inline(always)]
    fn colour(&self) -> V3<T> {
        self.ellipse.colour
    }

    fn centre_depth(&self) -> T {
        self.ellipse.depth
    }

    #[inline(always)]
    fn anchor(&self) -> [T; 2] {
        self.ellipse.mean
    }

    fn reach(&self, grid: TileGrid) -> PixelRect {
        Self::reach(self, grid.width, grid.height)
    }

    #[inline(always)]
    fn touches(&self, tile_x: usize, tile_y: usize) -> bool {
        // the ellipse at the cutoff; the square within which kernels are drawn already bounds the rectangle
        self.ellipse.touches(tile_x, tile_y)
    }

    #[inline(always)]
    fn draw<S: Simd>(&self, dx: Lanes<T, S>, dy: T) -> Option<Drawn<T, S>> {
        let (drawn, weight) = self.weights(dx, dy);
        Drawn::new(drawn, weight, Lanes::splat(dx.simd(), self.ellipse.depth))
    }

    #[inline(always)]
    fn gather<S: Simd, const MAPS: bool>(&self, group: &Group<T, S>, sums: &mut Sums<Lanes<T, S>>) {
        let [by_squared, by_degrees] = self.slopes(group.dx, group.dy);
        let (moments, rest) = sums.footprint.split_at_mut(MOMENTS);
        let [of_power, of_degrees] = rest else {
            unreachable!("two sums");
        };
        *of_power = *of_power + group.power;
        // with the term of the logarithm, which the published kernel leaves out
        *of_degrees = group.power.mul_add(by_degrees, *of_degrees);
        add_to_ellipse(self.ellipse.root, group, group.power * by_squared, moments, sums.probe);
        if MAPS {
            add_depths(sums.maps, group.grad_depth);
        }
    }

    fn backward(&self, view: &CameraPair<T>, parameters: &Parameters<T>, sums: &Sums<T>) -> ParameterGrad<T> {
        let rest = [sums.footprint[MOMENTS], sums.footprint[MOMENTS + 1]];
        let mut grad = student::backward(&view.camera, parameters, self, &sums.ellipse(), rest);
        sums.add_depth(view, parameters, &mut grad);
        grad
    }
}
