//! How large a scene is, and where to look at it from.

use dpges_core::camera::{Camera, CameraFromWorld};
use dpges_core::scene::SceneData;
use glam::DVec3;

use super::viewpoint::{Lens, Pose, Viewpoint};
use crate::percentile::percentiles;

const SAMPLE: usize = 8192;
/// Share of the positions that are nearer to the centre than the radius.
const INSIDE: f64 = 0.8;
/// Height of the first view above the horizon, as a share of its distance.
const ELEVATION: f64 = 0.35;
/// Cameras whose upward directions add up to less, per camera, have none in common.
const LEAST_COMMON_UP: f64 = 0.2;
const UP_STEPS: usize = 200;

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

    /// A view of the whole from somewhat above.
    pub fn overview(&self, lens: Lens, up: DVec3) -> Viewpoint {
        let distance = 1.15 * self.radius / (0.5 * lens.vertical_field_of_view).sin();
        let level = up.any_orthonormal_vector();
        let eye = self.centre + distance * (level + ELEVATION * up).normalize();
        let pose = Pose::of(&CameraFromWorld::look_at(eye, self.centre, up));
        Viewpoint { pose, focus_distance: distance, lens }
    }

    /// The view of `camera`, turning about what it mostly sees.
    pub fn seen_from(&self, camera: &Camera) -> Viewpoint {
        let seen = self.sample.iter().filter_map(|&point| camera.pixel(point));
        let depth = percentiles(seen.map(|(_, depth)| depth).collect(), [0.5]);
        Viewpoint::of(camera, depth.map_or(self.radius, |[depth]| depth))
    }
}

/// Upwards, as most of `cameras` are held: the direction that is most nearly at right angles to what is to the right of
/// each, since people hold cameras level however far they look up or down. −y if they agree on nothing.
pub fn mean_up<'a>(cameras: impl Iterator<Item = &'a Camera>) -> DVec3 {
    let poses: Vec<Pose> = cameras.map(|camera| Pose::of(&camera.camera_from_world)).collect();
    let count = poses.len() as f64;
    let sum = -poses.iter().map(Pose::down).sum::<DVec3>();
    if sum.length() <= LEAST_COMMON_UP * count {
        return DVec3::NEG_Y;
    }
    // power iteration: takes away, again and again, the parts along the directions to the right
    (0..UP_STEPS).fold(sum.normalize(), |up, _| {
        let along = poses.iter().map(|pose| pose.right().dot(up) * pose.right()).sum::<DVec3>();
        (count * up - along).normalize_or(up)
    })
}

#[cfg(test)]
mod tests {
    use glam::dvec3;

    use super::*;

    const LENS: Lens = Lens { vertical_field_of_view: 0.9, near: 0.01 };

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
            let view = extent.overview(LENS, up);
            let camera = view.camera([300, 300]);
            let inside = |point: &&DVec3| {
                camera.project(**point).is_some_and(|(x, y, _)| x > 0.0 && x < 300.0 && y > 0.0 && y < 300.0)
            };
            assert_eq!(ball().iter().filter(inside).count(), 500);
            assert!((view.focus() - extent.centre).length() < 1e-9);
            assert!((view.pose.eye - extent.centre).dot(up) > 0.0, "from above");
        }
    }

    #[test]
    fn scenes_without_points_or_size_have_a_view() {
        for points in [Vec::new(), vec![dvec3(1.0, 2.0, 3.0); 4]] {
            let extent = Extent::of_points(points, 7.0);
            assert_eq!(extent.radius, 7.0);
            assert!(extent.overview(LENS, DVec3::Z).pose.eye.is_finite());
        }
    }

    #[test]
    fn a_camera_turns_about_the_depth_of_what_it_sees() {
        let extent = Extent::of_points(ball(), 7.0);
        let camera = extent.overview(LENS, DVec3::Z).camera([300, 200]);
        let view = extent.seen_from(&camera);
        assert!((view.focus() - extent.centre).length() < 0.2, "{:?}", view.focus());
        assert!((view.lens.vertical_field_of_view - 0.9).abs() < 1e-9);
    }

    #[test]
    fn up_is_what_cameras_agree_on() {
        let held = |eye: DVec3, up| {
            let pose = Pose::of(&CameraFromWorld::look_at(eye, DVec3::ZERO, up));
            Viewpoint { pose, focus_distance: 1.0, lens: LENS }.camera([10, 10])
        };
        let from_above = [dvec3(1.0, 0.1, 0.9), dvec3(0.8, 0.6, 1.2), dvec3(0.0, 1.0, 0.7)];
        let cameras = from_above.map(|eye| held(eye, DVec3::Z));
        assert!(mean_up(cameras.iter()).dot(DVec3::Z) > 0.9999, "{}", mean_up(cameras.iter()));
        let alone = mean_up(cameras[..1].iter());
        assert!(alone.dot(-Pose::of(&cameras[0].camera_from_world).down()) > 0.9999, "{alone}");
        let odds = [held(DVec3::X, DVec3::Z), held(DVec3::X, DVec3::NEG_Z)];
        assert_eq!(mean_up(odds.iter()), DVec3::NEG_Y);
        assert_eq!(mean_up(std::iter::empty()), DVec3::NEG_Y);
    }
}
