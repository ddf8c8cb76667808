//! Gaussians that float before cameras leave. [`crate::eval::floaters`] counts what floats in a scene.

use rayon::prelude::*;

use crate::dataset::EmptySpace;

/// The `rows` whose `positions` [M × 3] (world units) are not in the `empty` space around cameras; all of them if all
/// are in it.
pub fn without_floaters(empty: &EmptySpace, rows: Vec<usize>, positions: &[f32]) -> Vec<usize> {
    let (positions, _) = positions.as_chunks::<3>();
    let kept: Vec<usize> = rows.par_iter().copied().filter(|&row| !empty.contains(positions[row])).collect();
    if kept.is_empty() && !rows.is_empty() {
        tracing::warn!(
            "each Gaussian is in the empty space before a camera: none is removed; are the points in their places?"
        );
        return rows;
    }
    kept
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dataset::{BuiltinOptions, PointCloud, builtin};

    #[test]
    fn what_is_before_a_camera_goes() {
        let mut data = builtin(&BuiltinOptions { width: 8, height: 8, train_views: 1, ..Default::default() });
        let centre = data.train[0].camera.centre().as_vec3();
        let at = |distance: f32| (centre + distance * glam::Vec3::X).to_array();
        let points = vec![at(2.0); 100];
        data.points = PointCloud {
            colours: vec![[0.5; 3]; 100],
            seen_by: vec![[0]; 100].into_iter().collect(),
            positions: points,
        };
        let empty = EmptySpace::of(&data);
        let positions = [at(0.9), at(1.1), at(-0.5), at(1.9)].concat();
        assert_eq!(without_floaters(&empty, vec![0, 1, 2], &positions), [1]);
        assert_eq!(without_floaters(&empty, vec![0, 2], &positions), [0, 2], "never all");
        assert_eq!(without_floaters(&EmptySpace::default(), vec![0, 1, 2, 3], &positions), [0, 1, 2, 3]);
    }
}
