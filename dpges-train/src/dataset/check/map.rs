//! Where cameras and points are, upright.

use glam::{DMat3, DVec3};

use super::poses::middle;
use super::{Report, Role};
use crate::dataset::Dataset;
use crate::init::sky::upwards;

/// Points on a map at most.
const MOST_POINTS: usize = 4000;

/// Cameras and points around the middle of the cameras, with z upwards; world units.
#[derive(Clone, Debug, PartialEq)]
pub struct Map {
    /// In the order of [`Report::views`].
    pub cameras: Vec<MapCamera>,
    pub points: Vec<MapPoint>,
}

#[derive(Clone, Debug, PartialEq)]
pub struct MapCamera {
    pub name: String,
    pub role: Role,
    /// Whether something was found about it.
    pub is_flagged: bool,
    pub position: [f64; 3],
    /// Unit vector in which it looks.
    pub forward: [f64; 3],
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MapPoint {
    pub position: [f64; 3],
    /// Red, green, blue in 0..1, display-referred.
    pub colour: [f32; 3],
}

impl Map {
    /// A map of the cameras of `dataset`, to which `report` belongs, and of an even choice of its points.
    pub fn of(dataset: &Dataset, report: &Report) -> Self {
        let up = upwards(report.views.iter().map(|view| &view.camera)).normalize_or(DVec3::Z);
        let right = up.any_orthonormal_vector();
        let map_from_world = DMat3::from_cols(right, up.cross(right), up).transpose();
        let origin = middle(&report.views);
        let place = |world: DVec3| (map_from_world * (world - origin)).to_array();
        let cameras = report.views.iter().map(|view| MapCamera {
            name: view.name.clone(),
            role: view.role,
            is_flagged: report.is_flagged(&view.name),
            position: place(view.camera.centre()),
            forward: (map_from_world * view.camera.camera_from_world.rotation.row(2)).to_array(),
        });
        let points = &dataset.points;
        let step = points.positions.len().div_ceil(MOST_POINTS).max(1);
        let chosen = points.positions.iter().zip(&points.colours).step_by(step);
        let points = chosen.map(|(position, &colour)| MapPoint {
            position: place(DVec3::from_array(position.map(f64::from))),
            colour,
        });
        Self { cameras: cameras.collect(), points: points.collect() }
    }
}
