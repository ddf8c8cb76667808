//! Splits Gaussians that are too large for the surfels around them (DP-GES, 3DGS).

use dpges_core::scene::GaussianData;
use rand_chacha::ChaCha8Rng;

use super::GaussianEdit;
use super::children::children;
use super::margins::NEIGHBOURS;
use crate::dataset::block::Bounds;
use crate::dataset::neighbours::{as_points, nearest_to};

/// Splits Gaussians whose mean scale exceeds `factor` × the mean of `margins` `[N]` (world units)
/// over the 16 surfels of `surfel_positions` [N × 3] nearest to them. The parent is
/// replaced by two children at `μ + R · N(0, diag s²)`, with its scales / 1.6 and otherwise its parameters.
///
/// At most as many Gaussians are split as there is room for, those within bounds that exceed their limit most; each adds one
/// row. Without surfels none is split. Returns also how many exceed it.
pub fn split(
    gaussians: &GaussianData,
    surfel_positions: &[f32],
    margins: &[f32],
    factor: f64,
    room: usize,
    bounds: Bounds,
    rng: &mut ChaCha8Rng,
) -> (GaussianEdit, usize) {
    let mut parents = parents(gaussians, surfel_positions, margins, factor);
    let (positions, _) = gaussians.positions.as_chunks::<3>();
    parents.retain(|&row| bounds.contains(positions[row]));
    let too_large = parents.len();
    parents.truncate(room);
    parents.sort_unstable();
    let mut is_parent = vec![false; gaussians.len()];
    parents.iter().for_each(|&row| is_parent[row] = true);

    let added = children(gaussians, parents.into_iter(), false, rng);
    (GaussianEdit { keep: (0..gaussians.len()).filter(|&row| !is_parent[row]).collect(), added }, too_large)
}

/// The rows to split, those that exceed their limit most first.
fn parents(gaussians: &GaussianData, surfel_positions: &[f32], margins: &[f32], factor: f64) -> Vec<usize> {
    let around = nearest_to(as_points(&gaussians.positions), as_points(surfel_positions), NEIGHBOURS);
    let (log_scales, _) = gaussians.log_scales.as_chunks::<3>();
    let excess = |row: usize| {
        let mean_scale = log_scales[row].iter().map(|s| f64::from(*s).exp()).sum::<f64>() / 3.0;
        let near = &around[row];
        let mean_margin = near.iter().map(|&(s, _)| f64::from(margins[s as usize])).sum::<f64>() / near.len() as f64;
        mean_scale / (factor * mean_margin)
    };
    let mut exceeding: Vec<(usize, f64)> = (0..gaussians.len())
        .filter(|&row| !around[row].is_empty())
        .map(|row| (row, excess(row)))
        .filter(|(_, excess)| *excess > 1.0)
        .collect();
    // ties by row, so that every rank splits the same ones
    exceeding.sort_by(|a, b| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0)));
    exceeding.into_iter().map(|(row, _)| row).collect()
}

#[cfg(test)]
mod tests {
    use super::super::fixtures::{self, MODEL, rng};
    use super::*;

    /// Gaussians of scale (4 s, s, s), whose long axis is y.
    fn gaussians(scales: &[f32]) -> GaussianData {
        let of_axes: Vec<[f32; 3]> = scales.iter().map(|s| [4.0 * s, *s, *s]).collect();
        fixtures::gaussians(&of_axes, (0..scales.len()).map(|i| i as f32).collect())
    }

    #[test]
    fn the_large_are_replaced_by_two_smaller() {
        let old = gaussians(&[0.9, 1.1, 0.5, 5.0]);
        let (edit, too_large) = split(&old, &[0.0; 9], &[1.0, 1.0, 1.0], 2.0, 10, Bounds::ALL, &mut rng(11));
        assert_eq!((&edit.keep, too_large), (&vec![0, 2], 2));
        assert_eq!(edit.added.opacities, [1.0, 1.0, 3.0, 3.0]);
        assert!((edit.added.log_scales[0] - (4.4f32 / 1.6).ln()).abs() < 1e-6);
        assert_eq!(edit.added.colour, old.select(&[1, 1, 3, 3]).colour);
        assert_eq!(edit.added.quaternions[..4], old.quaternions[..4]);
        assert_ne!(edit.added.positions[..3], edit.added.positions[3..6]);
        assert_eq!(edit.apply(&old).len(), 6);
    }

    #[test]
    fn room_goes_to_those_that_exceed_most() {
        let (edit, too_large) =
            split(&gaussians(&[3.0, 2.0, 5.0]), &[0.0; 3], &[1.0], 1.0, 2, Bounds::ALL, &mut rng(11));
        assert_eq!((edit.keep, too_large), (vec![1], 3));
        let (edit, too_large) = split(&gaussians(&[3.0, 2.0]), &[0.0; 3], &[1.0], 1.0, 0, Bounds::ALL, &mut rng(11));
        assert_eq!((edit.keep.len(), edit.added.len(), too_large), (2, 0, 2));
    }

    #[test]
    fn without_surfels_or_gaussians_nothing_is_split() {
        let (edit, _) = split(&gaussians(&[3.0, 2.0]), &[], &[], 2.0, 10, Bounds::ALL, &mut rng(11));
        assert_eq!((edit.keep.len(), edit.added.len()), (2, 0));
        let (edit, _) = split(&gaussians(&[]), &[0.0; 3], &[1.0], 2.0, 10, Bounds::ALL, &mut rng(11));
        assert_eq!(edit, GaussianEdit { added: GaussianData::neutral(MODEL, 0), ..GaussianEdit::default() });
    }
}
