//! The order in which Gaussians of a scene without layers are blended.

use dpges_core::camera::Camera;

/// Gaussians beyond the near plane of `camera`, the furthest first. At the same depth the later comes first, so that the
/// earlier is blended in front of it.
pub(crate) fn back_to_front(positions: &[[f32; 3]], camera: &Camera) -> Vec<u32> {
    let row = camera.camera_from_world.rotation.row(2);
    let [x, y, z] = row.to_array().map(|value| value as f32);
    let (shift, near) = (camera.camera_from_world.translation.z as f32, camera.near as f32);
    let depth = |p: &[f32; 3]| x * p[0] + y * p[1] + z * p[2] + shift;
    let all = positions.iter().enumerate().rev().map(|(index, position)| (depth(position), index as u32));
    let mut visible: Vec<(f32, u32)> = all.filter(|&(depth, _)| depth > near).collect();
    // stable
    radsort::sort_by_key(&mut visible, |&(depth, _)| -depth);
    visible.into_iter().map(|(_, index)| index).collect()
}

#[cfg(test)]
mod tests {
    use dpges_core::camera::CameraFromWorld;
    use glam::{DMat3, DVec3};

    use super::*;
    use crate::fixtures::pinhole;

    #[test]
    fn the_furthest_comes_first_and_nothing_behind_the_near_plane() {
        let pose = CameraFromWorld { rotation: DMat3::IDENTITY, translation: DVec3::new(0.0, 0.0, 1.0) };
        let camera = Camera { near: 0.5, ..pinhole(pose, 1.0, [1, 1]) };
        let positions = [[9.0, 0.0, 1.0], [0.0, 0.0, 5.0], [0.0, 0.0, -0.6], [0.0, 7.0, 1.0], [0.0, 0.0, -3.0]];
        assert_eq!(back_to_front(&positions, &camera), [1, 3, 0]);
    }
}
