//! Where in a picture there are points of structure from motion: without points a pose is not to be trusted, and where there
//! are none, surfaces must be found by training alone.

use dpges_core::camera::Camera;
use glam::DVec3;

use crate::Picture;

/// Squares along the longer side of a picture.
const SQUARES: usize = 12;

/// A picture in squares.
pub(super) struct Cells<'a> {
    camera: &'a Camera,
    columns: usize,
    rows: usize,
    /// Whether a square counts: whether at least half its pixels do.
    counted: Vec<bool>,
}

impl<'a> Cells<'a> {
    /// Without a `picture` all squares count.
    pub fn of(camera: &'a Camera, picture: Option<&Picture>) -> Self {
        let longer = camera.width.max(camera.height);
        let along = |length: usize| ((SQUARES * length) as f64 / longer as f64).round().max(1.0) as usize;
        let (columns, rows) = (along(camera.width), along(camera.height));
        let mut cells = Self { camera, columns, rows, counted: vec![true; columns * rows] };
        if let Some(counted) = picture.and_then(|picture| picture.counted.as_ref()) {
            let mut surplus = vec![0i64; columns * rows];
            for (pixel, &counts) in counted.iter().enumerate() {
                surplus[cells.square(pixel)] += if counts { 1 } else { -1 };
            }
            cells.counted = surplus.into_iter().map(|surplus| surplus >= 0).collect();
        }
        cells
    }

    fn square(&self, pixel: usize) -> usize {
        let Camera { width, height, .. } = *self.camera;
        pixel / width * self.rows / height * self.columns + pixel % width * self.columns / width
    }

    /// Share of the squares that count in which there is one of `positions`, in world units; `None` if no square counts.
    pub fn share_with(&self, positions: impl Iterator<Item = DVec3>) -> Option<f64> {
        let mut has_point = vec![false; self.counted.len()];
        for (pixel, _) in positions.filter_map(|position| self.camera.pixel(position)) {
            has_point[self.square(pixel)] = true;
        }
        let with_point = has_point.iter().zip(&self.counted).filter(|&(&has, &counts)| has && counts).count();
        let all = self.counted.iter().filter(|&&counts| counts).count();
        (all > 0).then(|| with_point as f64 / all as f64)
    }
}
