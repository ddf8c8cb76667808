//! Where nothing can be: around a camera that saw only what is far there is nothing close, but for what other cameras saw there.

use glam::{DVec3, Vec3};

use super::neighbours::Sites;
use super::{Dataset, PointCloud};

/// Radius of the empty space around a camera, relative to the distance of the nearest points that it saw.
const CLEARANCE: f64 = 0.5;
/// Share of the points of a view that are nearer than its nearest points: some are wrong.
const TOO_NEAR: f64 = 0.01;
/// Least number of points that say what is near a camera: of fewer there is no hundredth.
const ENOUGH_POINTS: usize = 100;

/// Distance to a point of the dataset within which nothing is empty, relative to the distance to the camera. A camera that looks
/// across a table without texture saw no point of it, but others did: without this, foregrounds vanish.
const NEAR_A_POINT: f64 = 0.1;

/// The empty space around the training cameras of a dataset.
#[derive(Default)]
pub struct EmptySpace {
    /// Centres of cameras and the distances up to which nothing is, world units.
    spheres: Vec<(DVec3, f64)>,
    /// All points of the dataset, whoever saw them.
    points: Sites,
}

impl EmptySpace {
    /// That around the training cameras of which it is known which points they saw, if they are a hundred or more: half the
    /// distance of the nearest of them, of which one in a hundred may be wrong. Around points of the dataset nothing is empty,
    /// up to a tenth of their distance from the camera.
    pub fn of(dataset: &Dataset) -> Self {
        let PointCloud { positions, seen_by, .. } = &dataset.points;
        let seen = dataset.train.iter().zip(seen_by.by_view(dataset.train.len()));
        let spheres = seen.filter(|(_, points)| points.len() >= ENOUGH_POINTS).map(|(view, points)| {
            let centre = view.camera.centre();
            let distance = |&point: &u32| centre.distance(Vec3::from_array(positions[point as usize]).as_dvec3());
            let mut distances: Vec<f64> = points.iter().map(distance).collect();
            let nearest = (TOO_NEAR * distances.len() as f64) as usize;
            (centre, CLEARANCE * *distances.select_nth_unstable_by(nearest, f64::total_cmp).1)
        });
        let spheres: Vec<(DVec3, f64)> = spheres.collect();
        let points = if spheres.is_empty() { Sites::default() } else { Sites::new(positions) };
        Self { spheres, points }
    }

    /// Whether `position` (world units) is in it.
    pub fn contains(&self, position: [f32; 3]) -> bool {
        let at = Vec3::from_array(position).as_dvec3();
        let around = self.spheres.iter().filter_map(|(centre, radius)| {
            let squared = at.distance_squared(*centre);
            (squared < radius * radius).then_some(squared)
        });
        let Some(to_camera) = around.reduce(f64::min) else { return false };
        f64::from(self.points.squared_distance(position)) >= NEAR_A_POINT * NEAR_A_POINT * to_camera
    }
}

#[cfg(test)]
mod tests {
    use dpges_core::camera::CameraFromWorld;

    use super::*;
    use crate::{BuiltinOptions, builtin};

    /// Two cameras 4 and 8 before the origin, of which the first saw `count` points there.
    fn dataset(count: usize) -> Dataset {
        let mut dataset = builtin(&BuiltinOptions { width: 16, height: 16, train_views: 2, ..Default::default() });
        for (view, distance) in dataset.train.iter_mut().zip([4.0, 8.0]) {
            let eye = DVec3::new(0.0, 0.0, -distance);
            view.camera.camera_from_world = CameraFromWorld::look_at(eye, DVec3::ZERO, -DVec3::Y);
        }
        let seen_by = vec![vec![0]; count].into_iter().collect();
        dataset.points = PointCloud { positions: vec![[0.0; 3]; count], colours: vec![[0.5; 3]; count], seen_by };
        dataset
    }

    #[test]
    fn half_way_to_the_points_that_a_camera_saw() {
        let empty = EmptySpace::of(&dataset(100));
        // behind the camera it is as empty as before it; the other camera saw nothing
        let at = [-1.9, -2.1, -4.0, -5.9, -6.1, -8.0];
        assert_eq!(at.map(|z| empty.contains([0.0, 0.0, z])), [false, true, true, true, false, false]);
    }

    #[test]
    fn one_point_in_a_hundred_may_be_wrong() {
        let mut data = dataset(200);
        data.points.positions[..2].fill([0.0, 0.0, -3.9]);
        assert!(EmptySpace::of(&data).contains([0.0, 0.0, -2.1]));
        data.points.positions[2] = [0.0, 0.0, -3.9];
        assert!(!EmptySpace::of(&data).contains([0.0, 0.0, -2.1]));
    }

    #[test]
    fn points_that_others_saw_are_not_empty_nor_what_is_around_them() {
        let mut data = dataset(100);
        data.points.append(&PointCloud {
            positions: vec![[0.0, 0.0, -3.0]],
            colours: vec![[0.5; 3]],
            seen_by: vec![[1]].into_iter().collect(),
        });
        let empty = EmptySpace::of(&data);
        // 1 from the camera that saw nothing there
        let at = [-2.88, -2.92, -3.0, -3.08, -3.12];
        assert_eq!(at.map(|z| empty.contains([0.0, 0.0, z])), [true, false, false, false, true]);
    }

    #[test]
    fn a_few_points_say_nothing() {
        assert!(EmptySpace::of(&dataset(99)).spheres.is_empty());
    }
}
