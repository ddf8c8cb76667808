//! Where a scene is and how large, by its cameras and by what they see: one astray camera or point sets neither.

use glam::DVec3;

use super::formats::source::RawPoints;

/// Cameras that may be astray, of all; from so many cameras on it may be one.
const ASTRAY: f64 = 0.1;
const FEWEST: usize = 5;
/// Distance from the middle of the cameras, over that of the farthest of the others, beyond which a camera is astray.
const FAR: f64 = 10.0;
/// Distance from the mean, over that of the mean from the origin, below which cameras are in one place.
const ROUNDING: f64 = 1e-12;
/// Distance from the middle, over the extent and over the median distance of the points, beyond which there is no point.
const FARTHEST_POINT: f64 = 1e5;

/// The mean of `centres` and the extent of the scene: 1.1 × the largest distance from it, 1 where that is 0. Up to a tenth of the
/// centres, ten times as far away as any other, are left out.
pub fn mean_and_extent(centres: &[DVec3]) -> (DVec3, f64) {
    let axis = |axis: usize| middle(centres.iter().map(|centre| centre[axis]));
    let median = DVec3::new(axis(0), axis(1), axis(2));
    let mut centres = centres.to_vec();
    centres.sort_by(|a, b| a.distance(median).total_cmp(&b.distance(median)));
    let most = if centres.len() < FEWEST { 0 } else { ((ASTRAY * centres.len() as f64) as usize).max(1) };
    let distance = |at: usize| centres[at].distance(median);
    let astray = (centres.len() - most..centres.len()).find(|&at| distance(at) > FAR * distance(at - 1));
    centres.truncate(astray.unwrap_or(centres.len()));
    let mean = centres.iter().sum::<DVec3>() / centres.len() as f64;
    let radius = centres.iter().map(|centre| centre.distance(mean)).fold(0.0, f64::max);
    (mean, if radius > ROUNDING * mean.length() { 1.1 * radius } else { 1.0 })
}

/// The upper of the medians, 0 without numbers.
pub fn middle(values: impl Iterator<Item = f64>) -> f64 {
    let mut values: Vec<f64> = values.collect();
    let at = values.len() / 2;
    if values.is_empty() { 0.0 } else { *values.select_nth_unstable_by(at, f64::total_cmp).1 }
}

/// Leaves out the points that are nowhere: not finite, or too far from the `mean` of the cameras. Returns their number.
pub fn drop_lost(points: &mut RawPoints, mean: DVec3, extent: f64) -> usize {
    let distance = |position: &DVec3| position.distance(mean);
    let usual = middle(points.positions.iter().map(distance).filter(|distance| distance.is_finite()));
    let is_somewhere = |position: &DVec3| distance(position) <= FARTHEST_POINT * extent.max(usual);
    let all = points.positions.len();
    if points.positions.iter().all(is_somewhere) {
        return 0;
    }
    let seen_by = std::mem::take(&mut points.seen_by);
    let kept: Vec<usize> = (0..all).filter(|&row| is_somewhere(&points.positions[row])).collect();
    points.positions = kept.iter().map(|&row| points.positions[row]).collect();
    points.colours = kept.iter().map(|&row| points.colours[row]).collect();
    points.seen_by = kept.iter().map(|&row| seen_by.of(row).iter().copied()).collect();
    all - kept.len()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn extent_is_a_tenth_more_than_the_farthest_camera_and_one_for_a_single_view() {
        let (mean, extent) = mean_and_extent(&[DVec3::ZERO, DVec3::X * 4.0]);
        assert_eq!((mean, extent), (DVec3::X * 2.0, 2.2));
        assert_eq!(mean_and_extent(&[DVec3::ONE]).1, 1.0);
    }

    #[test]
    fn a_few_astray_cameras_set_no_extent() {
        let mut centres: Vec<DVec3> = (0..20).map(|at| DVec3::new(f64::from(at % 5), f64::from(at / 5), 0.0)).collect();
        let (mean, extent) = mean_and_extent(&centres);
        for distance in [200.0, 1e3, 1e9] {
            centres.extend([DVec3::new(distance, 0.0, 0.0), DVec3::new(distance, 1.0, 0.0)]);
            let (found, of_rest) = mean_and_extent(&centres);
            assert!(found.distance(mean) < 1e-12 && (of_rest - extent).abs() < 1e-12, "{distance}");
            centres.truncate(20);
        }
        // not so far, or more than a few, they are part of it
        centres.push(DVec3::new(20.0, 0.0, 0.0));
        assert!(mean_and_extent(&centres).1 > 15.0);
        centres.extend((0..3).map(|at| DVec3::new(1e3, f64::from(at), 0.0)));
        assert!(mean_and_extent(&centres).1 > 500.0);
    }

    #[test]
    fn points_that_are_nowhere_are_left_out_with_their_tracks() {
        let positions =
            vec![DVec3::ZERO, DVec3::NAN, DVec3::X * 1e3, DVec3::Y * 1e9, DVec3::Z * f64::INFINITY, DVec3::ONE];
        let seen_by = [vec![0], vec![1], vec![2], vec![3], vec![4], vec![5]].into_iter().collect();
        let mut points = RawPoints { colours: vec![[0.5; 3]; 6], positions, seen_by };
        assert_eq!(drop_lost(&mut points, DVec3::ZERO, 2.0), 3);
        assert_eq!(points.positions, [DVec3::ZERO, DVec3::X * 1e3, DVec3::ONE]);
        assert_eq!(points.seen_by, [vec![0], vec![2], vec![5]].into_iter().collect());
        assert_eq!(drop_lost(&mut points, DVec3::ZERO, 2.0), 0);
    }
}
