//! The children of Gaussians that are split (3DGS).

use dpges_core::scene::GaussianData;
use glam::{DQuat, DVec3, Vec3};
use rand_chacha::ChaCha8Rng;

use super::normal;

/// Scale of a parent relative to its children (3DGS).
pub const SHRINKAGE: f64 = 1.6;

/// Two children of each of `parents`, drawn from its distribution, or in its plane if they are `flat`. Otherwise they are
/// the same but smaller.
pub fn children(
    gaussians: &GaussianData,
    parents: impl Iterator<Item = usize>,
    flat: bool,
    rng: &mut ChaCha8Rng,
) -> GaussianData {
    let twice: Vec<usize> = parents.flat_map(|row| [row, row]).collect();
    let mut children = gaussians.select(&twice);
    draw_positions(&mut children, gaussians, &twice, flat, rng);
    children.log_scales.iter_mut().for_each(|log_scale| *log_scale -= SHRINKAGE.ln() as f32);
    children
}

/// Moves `copies` of `rows` to points that are distributed as these are, or in their planes if they are `flat`.
pub fn draw_positions(
    copies: &mut GaussianData,
    gaussians: &GaussianData,
    rows: &[usize],
    flat: bool,
    rng: &mut ChaCha8Rng,
) {
    for (position, &row) in copies.positions.as_chunks_mut::<3>().0.iter_mut().zip(rows) {
        // a disc has no extent along its normal, whatever its third scale
        let draw = DVec3::new(normal(rng), normal(rng), if flat { 0.0 } else { normal(rng) });
        let inside = rotation(gaussians, row) * (vector(&gaussians.log_scales, row).exp() * draw);
        *position = (vector(&gaussians.positions, row) + inside).as_vec3().to_array();
    }
}

/// Row `row` of `values` [N × 3].
pub fn vector(values: &[f32], row: usize) -> DVec3 {
    Vec3::from_slice(&values[row * 3..][..3]).as_dvec3()
}

/// World from the axes of Gaussian `row`; a quaternion of length 0 is the identity.
pub fn rotation(gaussians: &GaussianData, row: usize) -> DQuat {
    let [w, x, y, z] = [0, 1, 2, 3].map(|i| f64::from(gaussians.quaternions[row * 4 + i]));
    let rotation = DQuat::from_xyzw(x, y, z, w);
    if rotation.length_squared() > 0.0 { rotation.normalize() } else { DQuat::IDENTITY }
}
