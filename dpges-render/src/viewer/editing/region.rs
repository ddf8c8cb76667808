//! Primitives whose centres lie in a region of the picture.

use dpges_core::camera::Camera;
use glam::{DVec2, DVec3};

/// A centre that lies behind the first surface by less than this share of its depth is seen: what covers a surface is about it.
const SLACK: f64 = 0.02;

/// A part of the picture, px.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Region {
    /// Between two opposite corners.
    Box([DVec2; 2]),
    /// Nearer than `radius` to the way that the middle of the brush went from one frame to the next.
    Brush { way: [DVec2; 2], radius: f64 },
}

impl Region {
    pub fn contains(&self, at: DVec2) -> bool {
        match *self {
            Self::Box([a, b]) => at.cmpge(a.min(b)).all() && at.cmple(a.max(b)).all(),
            Self::Brush { way: [from, to], radius } => {
                let way = to - from;
                let length = way.length_squared();
                let share = if length > 0.0 { ((at - from).dot(way) / length).clamp(0.0, 1.0) } else { 0.0 };
                at.distance_squared(from + share * way) <= radius * radius
            }
        }
    }
}

/// The rows of `positions` `[n, 3]` that `camera` shows within `region`, if `surfaces` has its depth [height, width] (0:
/// nothing is there) only those before them. Nothing beyond the edges of the picture or behind the camera is shown.
pub fn rows_within(positions: &[f32], camera: &Camera, region: &Region, surfaces: Option<&[f32]>) -> Vec<usize> {
    let is_within = |position: &[f32; 3]| {
        let centre = DVec3::from(position.map(f64::from));
        let Some((x, y, depth)) = camera.project(centre) else { return false };
        if !region.contains(DVec2::new(x, y)) {
            return false;
        }
        let Some((pixel, _)) = camera.pixel(centre) else { return false };
        let first = surfaces.and_then(|depths| depths.get(pixel)).map_or(0.0, |&depth| f64::from(depth));
        first == 0.0 || depth <= first * (1.0 + SLACK)
    };
    let positions = positions.as_chunks::<3>().0.iter().enumerate();
    positions.filter(|(_, position)| is_within(position)).map(|(row, _)| row).collect()
}

#[cfg(test)]
mod tests {
    use dpges_core::camera::CameraFromWorld;
    use glam::dvec2;

    use super::*;
    use crate::fixtures::pinhole;

    /// At z = -4, looking at +z: a point (x, y, 0) is shown at (32 + 10 x, 24 + 10 y) of 64 × 48 px.
    fn camera() -> Camera {
        let pose = CameraFromWorld::look_at(DVec3::new(0.0, 0.0, -4.0), DVec3::ZERO, DVec3::NEG_Y);
        pinhole(pose, 40.0, [64, 48])
    }

    const EVERYWHERE: Region = Region::Box([DVec2::splat(-1e9), DVec2::splat(1e9)]);

    #[test]
    fn a_box_takes_what_is_between_its_corners_however_far_away() {
        // in the middle; on the same ray, far behind; beside it
        let positions = [0.0, 0.0, 0.0, 0.0, 0.0, 36.0, 1.0, 0.0, 0.0];
        let within = |a, b| rows_within(&positions, &camera(), &Region::Box([a, b]), None);
        assert_eq!(within(dvec2(30.0, 20.0), dvec2(34.0, 28.0)), [0, 1]);
        assert_eq!(within(dvec2(43.0, 25.0), dvec2(41.0, 23.0)), [2], "whichever corner comes first");
        assert_eq!(within(dvec2(0.0, 0.0), dvec2(31.0, 48.0)), [0; 0]);
    }

    #[test]
    fn nothing_behind_the_camera_and_nothing_beyond_the_edges_is_taken() {
        // behind; in the plane of the eye; nearer than the near plane; left of the picture; in it
        let positions = [0.0, 0.0, -8.0, 0.1, 0.0, -4.0, 0.0, 0.0, -3.995, -4.0, 0.0, 0.0, -3.0, 0.0, 0.0];
        assert_eq!(rows_within(&positions, &camera(), &EVERYWHERE, None), [4]);
    }

    #[test]
    fn a_brush_leaves_no_gaps_between_frames() {
        let positions: Vec<f32> = (-3..=3).flat_map(|x| [x as f32, 0.0, 0.0]).collect();
        let within = |way, radius| rows_within(&positions, &camera(), &Region::Brush { way, radius }, None);
        assert_eq!(within([dvec2(32.0, 24.0); 2], 2.0), [3], "a press alone");
        assert_eq!(within([dvec2(32.0, 24.0); 2], 10.5), [2, 3, 4]);
        assert_eq!(within([dvec2(22.0, 25.0), dvec2(52.0, 25.0)], 2.0), [2, 3, 4, 5]);
        assert_eq!(within([dvec2(22.0, 27.0), dvec2(52.0, 27.0)], 2.0), [0; 0], "beside the way");
    }

    #[test]
    fn what_a_surface_hides_is_left_out() {
        let positions = [0.0, 0.0, 0.0, 0.0, 0.0, 0.05, 0.0, 0.0, 1.0, 1.0, 0.0, 1.0];
        let mut surfaces = vec![0.0; 64 * 48];
        surfaces[24 * 64 + 32] = 4.0;
        let seen = rows_within(&positions, &camera(), &EVERYWHERE, Some(&surfaces));
        assert_eq!(seen, [0, 1, 3], "on the surface, just behind it, and where there is none");
    }
}
