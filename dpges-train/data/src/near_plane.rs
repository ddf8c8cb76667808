//! The near plane of a dataset, by the points that its cameras see.

use super::formats::source::{Frame, RawPoints};
use super::sampled;
use super::world::middle;

/// Near plane over the depth of the nearest points that a view sees, over the median depth, and over the extent where there are
/// no points.
const NEAR: f64 = 0.1;
const LEAST_NEAR: f64 = 1e-3;
const NEAR_OF_EXTENT: f64 = 2.5e-3;
/// Share of the points of a view that are nearer than its nearest points: some are wrong.
const TOO_NEAR: f64 = 0.01;
/// Points that are projected into views, at most: where it is not known which views see them, and where it is.
const MOST_POINTS: usize = 20_000;
const MOST_SEEN: usize = 1_000_000;

/// The near plane of cameras that see `points`: a tenth of the depth of the nearest that any of them sees, and at least a
/// thousandth of the median. `extent` decides where there are none. World units.
pub fn near_plane(frames: &[Frame], points: &RawPoints, extent: f64) -> f64 {
    let RawPoints { positions, seen_by, .. } = points;
    let all: Vec<u32> = sampled(frames.len()).map(|frame| frame as u32).collect();
    let are_unknown = seen_by.are_unknown();
    let most = if are_unknown { MOST_POINTS } else { MOST_SEEN };
    let mut depths: Vec<Vec<f64>> = vec![Vec::new(); frames.len()];
    for point in (0..positions.len()).step_by(positions.len().div_ceil(most).max(1)) {
        for &frame in if are_unknown { &all } else { seen_by.of(point) } {
            let seen = frames[frame as usize].camera.pixel(positions[point]);
            depths[frame as usize].extend(seen.map(|(_, depth)| depth));
        }
    }
    let nearest = depths.iter_mut().filter(|depths| !depths.is_empty()).map(|depths| {
        let at = (TOO_NEAR * depths.len() as f64) as usize;
        *depths.select_nth_unstable_by(at, f64::total_cmp).1
    });
    match nearest.min_by(f64::total_cmp) {
        Some(nearest) => (NEAR * nearest).max(LEAST_NEAR * middle(depths.into_iter().flatten())),
        None => NEAR_OF_EXTENT * extent,
    }
}
