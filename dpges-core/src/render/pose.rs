//! The gradient of a loss with respect to a motion of the camera.
//!
//! Operations take cameras as constants. A camera that is turned about its centre `c` by a small rotation vector `w` and
//! shifted by `t` sees what the camera that stays sees of a world that moves the other way:
//!
//! ```text
//! positions     p − w × (p − c) − t
//! quaternions   q − ½ (0, w) q
//! environment   E(exp(w) v)
//! ```
//!
//! Colours depend on the direction from the camera to a primitive in the axes of the world. The turn leaves that as it is.
//! The change by the shift is left out, as directions pass no gradient to positions either
//! ([`colour`](mod@crate::ops::colour)).
//!
//! The motion is 0. The picture is the same to the bit as without it, and apart from the effect of a shift on colours its
//! derivatives are exact.

use burn::tensor::{DType, Device, Gradients, Tensor};

use crate::camera::Camera;
use crate::counters::transfers::uploaded;
use crate::ops::environment::turn::generators;
use crate::scene::{Gaussians, Surfels};

/// A motion of a camera by nothing, whose gradient says how much a loss wants it.
#[derive(Clone, Debug)]
pub struct PoseProbe {
    /// [1, 6] a rotation vector, rad, and a shift, world units, both along world axes.
    motion: Tensor<2>,
    /// [1, 3] of the camera, world units.
    centre: Tensor<2>,
    /// Whether surfels and environment move too.
    moves_all: bool,
}

impl PoseProbe {
    /// A probe for `camera`, on the tape of `device`, for primitives of `dtype`.
    pub fn new(camera: &Camera, device: &Device, dtype: DType) -> Self {
        let motion = Tensor::zeros([1, 6], (device, dtype)).require_grad();
        let centre = uploaded(camera.centre().to_array().to_vec(), [1, 3], device, dtype);
        Self { motion, centre, moves_all: true }
    }

    /// The same for Gaussians alone. Where these are sharded over [ranks](crate::ranks), and surfels and environment are not,
    /// the gradients of all ranks add up to the whole if one of them moves everything, and the others Gaussians alone.
    #[must_use]
    pub fn of_gaussians(self) -> Self {
        Self { moves_all: false, ..self }
    }

    /// [1, 6] the gradient that a backward pass left: of the rotation vector, rad, by which the camera is turned about its
    /// centre, then of its shift, world units, along world axes. `None` if nothing reached it.
    pub fn gradient(&self, gradients: &mut Gradients) -> Option<Tensor<2>> {
        self.motion.grad_remove(gradients)
    }

    /// `surfels` as the camera sees them, but for their colours.
    pub fn surfels(&self, surfels: &Surfels) -> Surfels {
        if !self.moves_all {
            return surfels.clone();
        }
        let (positions, quaternions) = self.moved(&surfels.positions, &surfels.quaternions);
        Surfels { positions, quaternions, ..surfels.clone() }
    }

    /// `gaussians` as the camera sees them, but for their colours.
    pub fn gaussians(&self, gaussians: &Gaussians) -> Gaussians {
        let (positions, quaternions) = self.moved(&gaussians.positions, &gaussians.quaternions);
        Gaussians { positions, quaternions, ..gaussians.clone() }
    }

    /// `coefficients` [(degree + 1)², 3] of an [environment](mod@crate::ops::environment) as the camera sees it.
    pub fn environment(&self, coefficients: &Tensor<2>) -> Tensor<2> {
        if !self.moves_all {
            return coefficients.clone();
        }
        let [count, _] = coefficients.dims();
        let (device, dtype) = (coefficients.device(), coefficients.dtype());
        let changes = generators(count)
            .map(|matrix| uploaded(matrix, [count, count], &device, dtype).matmul(coefficients.clone().detach()));
        less(coefficients, self.turn() * -1.0, changes)
    }

    /// [1, 3] rotation vector.
    fn turn(&self) -> Tensor<2> {
        self.motion.clone().slice([0..1, 0..3])
    }

    /// [1, 3]
    fn shift(&self) -> Tensor<2> {
        self.motion.clone().slice([0..1, 3..6])
    }

    fn moved(&self, positions: &Tensor<2>, quaternions: &Tensor<2>) -> (Tensor<2>, Tensor<2>) {
        if positions.dims()[0] == 0 {
            return (positions.clone(), quaternions.clone());
        }
        // axis × (p − c)
        let [x, y, z] = columns(&(positions.clone().detach() - self.centre.clone()));
        let none = x.zeros_like();
        let turned =
            [[none.clone(), z.clone() * -1.0, y.clone()], [z, none.clone(), x.clone() * -1.0], [y * -1.0, x, none]];
        let turned = turned.map(|columns| Tensor::cat(columns.into(), 1));
        let positions = less(positions, self.turn(), turned) - self.shift();
        // ½ (0, axis) q
        let [w, x, y, z] = columns(&(quaternions.clone().detach() * 0.5));
        let [minus_x, minus_y, minus_z] = [&x, &y, &z].map(|column| column.clone() * -1.0);
        let turned = [
            [minus_x.clone(), w.clone(), minus_z.clone(), y],
            [minus_y.clone(), z, w.clone(), minus_x],
            [minus_z, minus_y, x, w],
        ];
        let turned = turned.map(|columns| Tensor::cat(columns.into(), 1));
        (positions, less(quaternions, self.turn(), turned))
    }
}

fn columns<const C: usize>(values: &Tensor<2>) -> [Tensor<2>; C] {
    let [rows, _] = values.dims();
    std::array::from_fn(|column| values.clone().slice([0..rows, column..column + 1]))
}

/// `values` less the sum of the three `changes`, all of one shape, each times its number in `turn` [1, 3].
fn less(values: &Tensor<2>, turn: Tensor<2>, changes: [Tensor<2>; 3]) -> Tensor<2> {
    let angles = columns::<3>(&turn);
    angles.into_iter().zip(changes).fold(values.clone(), |values, (angle, change)| values - change * angle)
}

#[cfg(test)]
mod tests;
