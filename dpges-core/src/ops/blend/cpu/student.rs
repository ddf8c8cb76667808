//! Ellipses with kernels of Student's t distribution.

use super::projected::{CameraPair, Group, Projected, Sums, WORK_ROWS, add_depths, add_to_probe, thinnest_axis};
use crate::backend::real::Real;
use crate::backend::simd::LANES;
use crate::footprint::gaussian::cpu::student::{self, Student};
use crate::footprint::gaussian::cpu::{ParameterGrad, Parameters, SplatGrad};
use crate::footprint::moments::{MOMENTS, add_moments};
use crate::math::{V3, add, scale};
use crate::tiles::{PixelRect, TileGrid};

impl<T: Real> Projected<T> for Student<T> {
    /// The moments of the gradient of r² times −2, the gradient of the exponent, that of ν.
    const SUMS: usize = MOMENTS + 2;
    const HAS_DEGREES: bool = true;

    fn new(view: &CameraPair<T>, parameters: &Parameters<T>, colour: V3<T>) -> Option<Self> {
        Self::new(&view.camera, parameters, colour)
    }

    fn normal_axis(parameters: &Parameters<T>) -> usize {
        thinnest_axis(parameters)
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
        self.ellipse.touches(tile_x, tile_y)
    }

    #[inline(always)]
    fn fragments(&self, dx: &[T; LANES], dy: T, weight: &mut [T; LANES], depth: &mut [T; LANES]) {
        self.weights(dx, dy, weight);
        depth.fill(self.ellipse.depth);
    }

    #[inline(always)]
    fn gather<const MAPS: bool>(
        &self,
        group: &Group<T>,
        work: &mut [[T; LANES]; WORK_ROWS],
        sums: &mut Sums<[T; LANES]>,
    ) {
        let (dx, dy, power) = (group.dx, group.dy, group.power);
        let [by_squared, by_degrees, u, ..] = work;
        self.slopes(dx, dy, by_squared, by_degrees);
        let (moments, rest) = sums.footprint.split_at_mut(MOMENTS);
        let [of_power, of_degrees] = rest else {
            unreachable!("two rows of lanes");
        };
        for lane in 0..LANES {
            of_power[lane] = of_power[lane] + power[lane];
            of_degrees[lane] = of_degrees[lane] + power[lane] * by_degrees[lane];
        }
        let [p, q, r] = self.ellipse.root;
        for lane in 0..LANES {
            by_squared[lane] = power[lane] * by_squared[lane];
            u[lane] = p * dx[lane] + q * dy;
        }
        let v = r * dy;
        add_moments(moments, by_squared, u, v);
        add_to_probe(sums.probe, self.ellipse.root, by_squared, u, v);
        if MAPS {
            add_depths(sums.maps, group.grad_depth);
        }
    }

    fn backward(&self, view: &CameraPair<T>, parameters: &Parameters<T>, sums: &Sums<T>) -> ParameterGrad<T> {
        let sum = SplatGrad {
            moments: std::array::from_fn(|i| sums.footprint[i]),
            colour: std::array::from_fn(|c| sums.colour[c]),
        };
        let rest = [sums.footprint[MOMENTS], sums.footprint[MOMENTS + 1]];
        let mut grad = student::backward(&view.camera, parameters, self, &sum, rest);
        if let [.., of_depth] = *sums.maps {
            grad.position = add(grad.position, scale(view.camera.depth_slope(parameters.position), of_depth));
        }
        grad
    }
}
