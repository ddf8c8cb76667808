//! The depth of a mesh, for comparisons.

use dpges_core::camera::Camera;
use glam::{DVec2, DVec3};

use super::TriangleMesh;

/// Camera-space z [H, W] of the nearest triangle at the centre of every pixel, world units; 0 where there is none.
/// Triangles that reach behind the near plane are left out.
pub fn depth_map(mesh: &TriangleMesh, camera: &Camera) -> Vec<f32> {
    let mut depths = vec![0.0; camera.width * camera.height];
    let project = |&position: &[f32; 3]| camera.project(glam::Vec3::from(position).as_dvec3());
    let projected: Vec<Option<(f64, f64, f64)>> = mesh.positions.iter().map(project).collect();
    for triangle in &mesh.triangles {
        if let [Some(a), Some(b), Some(c)] = triangle.map(|index| projected[index as usize]) {
            draw(&mut depths, camera, [a, b, c]);
        }
    }
    depths
}

/// Draws a triangle of corners (x px, y px, depth).
fn draw(depths: &mut [f32], camera: &Camera, corners: [(f64, f64, f64); 3]) {
    let points = corners.map(|(x, y, _)| DVec2::new(x, y));
    let inverse_depths = DVec3::from_array(corners.map(|(_, _, depth)| 1.0 / depth));
    let area = (points[1] - points[0]).perp_dot(points[2] - points[0]);
    if area == 0.0 {
        return;
    }
    let low = points[0].min(points[1]).min(points[2]);
    let high = points[0].max(points[1]).max(points[2]);
    // pixels whose centres may lie inside
    let range = |low: f64, high: f64, size: usize| {
        let first = (low - 0.5).ceil().max(0.0) as usize;
        let end = ((high - 0.5).floor() + 1.0).clamp(0.0, size as f64) as usize;
        first..end
    };
    for row in range(low.y, high.y, camera.height) {
        for column in range(low.x, high.x, camera.width) {
            let pixel = DVec2::new(column as f64 + 0.5, row as f64 + 0.5);
            let share = |from: usize, to: usize| (points[to] - points[from]).perp_dot(pixel - points[from]) / area;
            let shares = DVec3::new(share(1, 2), share(2, 0), share(0, 1));
            if shares.min_element() >= 0.0 {
                let depth = (1.0 / shares.dot(inverse_depths)) as f32;
                let nearest = &mut depths[row * camera.width + column];
                if *nearest == 0.0 || depth < *nearest {
                    *nearest = depth;
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use dpges_core::camera::CameraFromWorld;

    use super::*;
    use crate::fixtures::pinhole;

    #[test]
    fn the_nearest_of_two_planes_is_seen_exactly() {
        let pose = CameraFromWorld::look_at(DVec3::new(0.0, 0.0, -2.0), DVec3::ZERO, -DVec3::Y);
        let camera = pinhole(pose, 20.0, [16, 16]);
        // a slope z = x over everything, and behind it a wall at z = 3
        let slope = [[-1.0, -3.0, -1.0], [3.0, -3.0, 3.0], [-1.0, 9.0, -1.0]];
        let wall = [[-9.0, -9.0, 3.0], [30.0, -9.0, 3.0], [-9.0, 30.0, 3.0]];
        let (positions, triangles) = ([slope, wall].concat(), vec![[3, 4, 5], [0, 1, 2]]);
        let mesh = TriangleMesh { positions, triangles, ..Default::default() };
        let depths = depth_map(&mesh, &camera);
        for (x, y) in [(8usize, 8usize), (5, 9), (11, 7)] {
            // the ray (s, ·, 1) from z = −2 meets z = x at t with t s = t − 2
            let s = (x as f64 + 0.5 - 8.0) / 20.0;
            let expected = 2.0 / (1.0 - s);
            assert!((f64::from(depths[y * 16 + x]) - expected).abs() < 1e-5, "{x} {y}: {}", depths[y * 16 + x]);
        }
        assert!(depths.iter().all(|&depth| depth > 0.0));
        assert!(depth_map(&TriangleMesh::default(), &camera).iter().all(|&depth| depth == 0.0));
    }
}
