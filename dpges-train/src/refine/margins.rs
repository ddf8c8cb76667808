//! The depth margin ε of every surfel: Gaussians this far behind it still contribute (GES, DP-GES), by
//! [`visibility`](dpges_core::ops::visibility::visibility).

use crate::config::Margin;
use crate::dataset::neighbours::{as_points, nearest};

/// Number of neighbouring surfels whose margins are used.
pub const NEIGHBOURS: usize = 16;

/// Margins `[N]` in world units of surfels at `positions` [N × 3] with `log_scales` [N × 2].
///
/// [`Margin::Raw`]: ε = `2.5 (s_x + s_y)`. [`Margin::Median`]: the lower median of these over the 16
/// nearest other surfels, or all others if there are fewer. A single surfel keeps its own.
pub fn margins(positions: &[f32], log_scales: &[f32], kind: Margin) -> Vec<f32> {
    let raw: Vec<f32> = log_scales.as_chunks::<2>().0.iter().map(|[x, y]| 2.5 * (x.exp() + y.exp())).collect();
    if kind == Margin::Raw {
        return raw;
    }
    let around = nearest(as_points(positions), NEIGHBOURS);
    let median_around = |(own, neighbours): (&f32, Vec<(u32, f32)>)| {
        let mut values: Vec<f32> = neighbours.iter().map(|&(row, _)| raw[row as usize]).collect();
        let Some(last) = values.len().checked_sub(1) else { return *own };
        // the largest value of the smaller half: of 16 values the 8th smallest
        *values.select_nth_unstable_by(last / 2, f32::total_cmp).1
    };
    raw.iter().zip(around).map(median_around).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Surfels on a line at x = 0, 1, 2, … with raw margins `raw`.
    fn line(raw: &[f32]) -> (Vec<f32>, Vec<f32>) {
        let positions = (0..raw.len()).flat_map(|i| [i as f32, 0.0, 0.0]).collect();
        (positions, raw.iter().flat_map(|raw| [(raw / 5.0).ln(); 2]).collect())
    }

    fn close(found: &[f32], expected: &[f32]) -> bool {
        found.len() == expected.len() && found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-5)
    }

    #[test]
    fn the_median_is_the_8th_smallest_of_16_others() {
        let raw: Vec<f32> = (1..=17).map(|i| i as f32).collect();
        let (positions, log_scales) = line(&raw);
        let found = margins(&positions, &log_scales, Margin::Median);
        assert!(close(&found[..1], &[9.0]) && close(&found[16..], &[8.0]), "{found:?}");
        assert!(close(&margins(&positions, &log_scales, Margin::Raw), &raw));
    }

    #[test]
    fn outliers_among_neighbours_do_not_matter_and_far_surfels_neither() {
        let mut raw = vec![1.0; 17];
        raw[8] = 500.0;
        raw.extend([77.0; 40]);
        let (mut positions, log_scales) = line(&raw);
        positions[17 * 3..].iter_mut().for_each(|x| *x += 1e3);
        assert!(close(&margins(&positions, &log_scales, Margin::Median)[..17], &[1.0; 17]));
    }

    #[test]
    fn few_surfels() {
        let medians = |raw: &[f32]| {
            let (positions, log_scales) = line(raw);
            margins(&positions, &log_scales, Margin::Median)
        };
        assert!(medians(&[]).is_empty());
        assert!(close(&medians(&[3.0]), &[3.0]));
        assert!(close(&medians(&[3.0, 1.0]), &[1.0, 3.0]));
        assert!(close(&medians(&[3.0, 1.0, 2.0]), &[1.0, 2.0, 1.0]));
    }
}
