//! How large a scene is, and where to look at it from.

use dpges_core::camera::{Camera, CameraFromWorld};
use dpges_core::scene::SceneData;
use glam::{DQuat, DVec3};

use crate::percentile::percentiles;
use crate::up::Up;

const SAMPLE: usize = 8192;
/// Share of the positions that are nearer to the centre than the radius.
const INSIDE: f64 = 0.8;
/// Distance from a pixel within which primitives say how far it is, as a share of the picture's height.
const AROUND: f64 = 0.04;
/// Share of what is around a pixel that is nearer than what is seen there: the rest lies behind it.
const IN_FRONT: f64 = 0.2;
/// Height of the first view above the horizon, as a share of its distance.
const ELEVATION: f64 = 0.35;
/// Cameras of a ring around a scene, and the size of their pictures, px.
const RING: usize = 24;
const RING_PX: [usize; 2] = [800, 600];
/// Vertical field of view where no camera gives one, rad.
pub const FIELD_OF_VIEW: f64 = 0.9;

/// Where the primitives of a scene are; a few that are far off do not matter.
#[derive(Clone, Debug, PartialEq)]
pub struct Extent {
    /// Median of each coordinate, world units.
    pub centre: DVec3,
    /// World units, positive.
    pub radius: f64,
    sample: Vec<DVec3>,
}

impl Extent {
    pub fn of(scene: &SceneData) -> Self {
        let all = [&scene.surfels.positions, &scene.gaussians.positions];
        let count = all.iter().map(|positions| positions.len() / 3).sum::<usize>();
        let stride = count.div_ceil(SAMPLE).max(1);
        let positions = all.into_iter().flat_map(|positions| positions.chunks_exact(3));
        let point = |row: &[f32]| DVec3::new(row[0].into(), row[1].into(), row[2].into());
        Self::of_points(positions.step_by(stride).map(point).collect(), scene.info.extent)
    }

    fn of_points(sample: Vec<DVec3>, otherwise: f64) -> Self {
        let along = |axis: usize| percentiles(sample.iter().map(|point| point[axis]).collect(), [0.5]);
        let centre = DVec3::from([0, 1, 2].map(|axis| along(axis).map_or(0.0, |[median]| median)));
        let distances = sample.iter().map(|point| (*point - centre).length()).collect();
        let radius = percentiles(distances, [INSIDE]).map_or(0.0, |[radius]| radius);
        Self { centre, radius: if radius > 0.0 { radius } else { otherwise }, sample }
    }

    /// A view of the whole from somewhat above, with pictures of `size` px.
    pub fn overview(&self, up: DVec3, near: f64, size: [usize; 2]) -> Camera {
        let distance = 1.15 * self.radius / (0.5 * FIELD_OF_VIEW).sin();
        let eye = self.centre + distance * (up.any_orthonormal_vector() + ELEVATION * up).normalize();
        let focal_px = 0.5 * size[1] as f64 / (0.5 * FIELD_OF_VIEW).tan();
        Camera::pinhole(CameraFromWorld::look_at(eye, self.centre, up), focal_px, size, near)
    }

    /// Cameras that look at the whole of `scene` from all sides.
    pub fn ring(scene: &SceneData) -> Vec<Camera> {
        let (extent, up) = (Self::of(scene), Up::of(&scene.info).direction());
        let first = extent.overview(up, scene.info.near, RING_PX);
        let turned = |number: usize| {
            let turn = DQuat::from_axis_angle(up, std::f64::consts::TAU * number as f64 / RING as f64);
            let eye = extent.centre + turn * (first.centre() - extent.centre);
            Camera { camera_from_world: CameraFromWorld::look_at(eye, extent.centre, up), ..first }
        };
        (0..RING).map(turned).collect()
    }

    /// Depth of what `camera` mostly sees, world units.
    pub fn depth_before(&self, camera: &Camera) -> f64 {
        let seen = self.sample.iter().filter_map(|&point| camera.pixel(point));
        percentiles(seen.map(|(_, depth)| depth).collect(), [0.5]).map_or(self.radius, |[depth]| depth)
    }

    /// What `camera` sees at (`x_px`, `y_px`), by the primitives around that pixel; `None` where there are none.
    pub fn point_at(&self, camera: &Camera, x_px: f64, y_px: f64) -> Option<DVec3> {
        let reach_px = AROUND * camera.height as f64;
        let near_pixel = self.sample.iter().filter_map(|&point| {
            let (x, y, depth) = camera.project(point)?;
            ((x - x_px).hypot(y - y_px) <= reach_px).then_some(depth)
        });
        let mut depths: Vec<f64> = near_pixel.collect();
        depths.sort_unstable_by(f64::total_cmp);
        // around a pixel, a surface twice as far has four times as many primitives
        let weight = |depth: &f64| depth.powi(-2);
        let mut before = IN_FRONT * depths.iter().map(weight).sum::<f64>();
        let depth = depths.into_iter().find(|depth| {
            before -= weight(depth);
            before <= 0.0
        })?;
        Some(camera.unproject(x_px, y_px, depth))
    }
}

#[cfg(test)]
mod tests {
    use glam::dvec3;

    use super::*;
    use crate::fixtures::directions;

    fn ball() -> Vec<DVec3> {
        let point = |index: i32| {
            let angle = f64::from(index);
            dvec3(5.0, -2.0, 1.0) + dvec3(angle.cos(), angle.sin(), (0.7 * angle).sin()).normalize()
        };
        (0..500).map(point).collect()
    }

    #[test]
    fn a_few_points_far_off_do_not_matter() {
        let mut points = ball();
        let alone = Extent::of_points(points.clone(), 7.0);
        points.extend([dvec3(1e6, 0.0, 0.0), dvec3(-1e5, 3e5, 1e6)]);
        let with_outliers = Extent::of_points(points, 7.0);
        assert!((alone.centre - dvec3(5.0, -2.0, 1.0)).length() < 0.1, "{:?}", alone.centre);
        assert!((with_outliers.centre - alone.centre).length() < 0.02);
        assert!((alone.radius - 1.0).abs() < 0.1 && (with_outliers.radius - alone.radius).abs() < 0.02);
    }

    #[test]
    fn the_overview_shows_the_whole() {
        let extent = Extent::of_points(ball(), 7.0);
        for up in [DVec3::Z, DVec3::NEG_Y] {
            let camera = extent.overview(up, 0.01, [300, 300]);
            let inside = |point: &&DVec3| {
                camera.project(**point).is_some_and(|(x, y, _)| x > 0.0 && x < 300.0 && y > 0.0 && y < 300.0)
            };
            assert_eq!(ball().iter().filter(inside).count(), 500);
            assert!((camera.centre() - extent.centre).dot(up) > 0.0, "from above");
        }
    }

    #[test]
    fn scenes_without_points_or_size_have_a_view() {
        for points in [Vec::new(), vec![dvec3(1.0, 2.0, 3.0); 4]] {
            let extent = Extent::of_points(points, 7.0);
            assert_eq!(extent.radius, 7.0);
            assert!(extent.overview(DVec3::Z, 0.01, [8, 8]).centre().is_finite());
        }
    }

    #[test]
    fn the_depth_before_a_camera_is_that_of_what_it_sees() {
        let extent = Extent::of_points(ball(), 7.0);
        let camera = extent.overview(DVec3::Z, 0.01, [300, 200]);
        let distance = (camera.centre() - extent.centre).length();
        assert!((extent.depth_before(&camera) - distance).abs() < 0.2, "{distance}");
    }

    #[test]
    fn the_point_at_a_pixel_is_in_front() {
        let points = directions(8000).map(|direction| dvec3(5.0, -2.0, 1.0) + direction);
        let extent = Extent::of_points(points.collect(), 7.0);
        let camera = extent.overview(DVec3::Z, 0.01, [300, 200]);
        let [before, behind] =
            [-1.0, 1.0].map(|along| extent.centre + along * camera.camera_from_world.rotation.row(2));
        let point = extent.point_at(&camera, 150.0, 100.0).unwrap();
        assert!(point.distance(before) < 0.1 && point.distance(behind) > 1.0, "{point}");
        assert_eq!(extent.point_at(&camera, 2.0, 2.0), None);
    }
}
