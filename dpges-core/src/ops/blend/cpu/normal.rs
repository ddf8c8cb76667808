//! The axis of a primitive that serves as its normal.

use crate::backend::real::Real;
use crate::footprint::gaussian::cpu::Parameters;
use crate::math::{CameraOf, M3, V3, apply, apply_transposed, column, dot, rotation, rotation_backward, scale};

/// −1 if the axis points away from the camera, else 1, and the axis in camera axes.
fn oriented<T: Real>(camera: &CameraOf<T>, parameters: &Parameters<T>, axis: usize) -> (T, V3<T>) {
    let normal = apply(&camera.rotation, column(&rotation(parameters.quaternion), axis));
    // an axis and its opposite are the same Gaussian; the choice is a step, without a gradient
    let away = dot(normal, camera.transform(parameters.position)) > T::zero();
    (if away { -T::one() } else { T::one() }, normal)
}

/// An axis in camera axes, turned so that it faces the camera.
pub fn normal<T: Real>(camera: &CameraOf<T>, parameters: &Parameters<T>, axis: usize) -> V3<T> {
    let (sign, normal) = oriented(camera, parameters, axis);
    scale(normal, sign)
}

/// Gradient with respect to the raw quaternion from that with respect to [`normal`].
pub fn normal_backward<T: Real>(camera: &CameraOf<T>, parameters: &Parameters<T>, axis: usize, grad: V3<T>) -> [T; 4] {
    let (sign, _) = oriented(camera, parameters, axis);
    let grad_axis = scale(apply_transposed(&camera.rotation, grad), sign);
    let mut grad_rotation: M3<T> = [[T::zero(); 3]; 3];
    for (row, value) in grad_rotation.iter_mut().zip(grad_axis) {
        row[axis] = value;
    }
    rotation_backward(parameters.quaternion, &grad_rotation)
}
