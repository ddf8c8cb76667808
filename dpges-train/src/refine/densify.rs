//! Adaptive density control: rows with large positional gradients are cloned if they are small and split if they are
//! large; faint and huge rows are pruned (3DGS, 2DGS, GES).

use dpges_core::scene::GaussianData;
use rand_chacha::ChaCha8Rng;

use super::GaussianEdit;
use super::children::{SHRINKAGE, children, draw_positions};

/// The decision by sums of absolute gradients.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum ByAbsolute {
    /// Nothing (3DGS, 2DGS).
    #[default]
    Nothing,
    /// As many rows again are densified: those at or above the quantile of the share of rows below
    /// [`DensifyRule::gradient_threshold`] (GES, Mip-Splatting).
    Quantile,
    /// Which large rows are split: those of at least this mean norm. Then the signed gradients decide only which small ones
    /// are cloned (AbsGS).
    Splits(f64),
}

/// The thresholds of cloning, splitting and pruning.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DensifyRule {
    /// Least mean gradient norm of a row that is densified, per unit of normalised device coordinates (3DGS: 2e-4).
    pub gradient_threshold: f64,
    pub by_absolute: ByAbsolute,
    /// Fraction of the extent; larger rows are split, the others cloned (3DGS: 0.01).
    pub dense_fraction: f64,
    /// Rows of less opacity are pruned (2DGS: 0.05, 3DGS: 0.005).
    pub min_opacity: f64,
    /// Fraction of the extent; larger rows are pruned (3DGS: 0.1, after the first opacity reset).
    pub max_scale_fraction: Option<f64>,
    /// Whether the rows are discs. Then the third scale is ignored, and children lie in the plane of the first two axes.
    pub flat: bool,
    /// Whether clones lie where a point of their originals is drawn, and not in the same place (GOF, HTGS).
    pub draws_clones: bool,
}

/// Gradients of N rows, summed over views since the last densification.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct GradientSums {
    /// `[N]` sum over views of the norm of the gradient with respect to the projected centre,
    /// normalised device coordinates.
    pub signed: Vec<f32>,
    /// `[N]` the same of the gradient whose components are summed over pixels by absolute value.
    pub absolute: Vec<f32>,
    /// `[N]` views that saw the row.
    pub views: Vec<u32>,
}

impl GradientSums {
    /// Means of `sums` over the views that saw a row; 0 without such views, or if the mean is not finite.
    fn means(&self, sums: &[f32]) -> Vec<f64> {
        let mean = |(sum, views): (&f32, &u32)| f64::from(*sum) / f64::from(*views);
        let finite = |mean: f64| if mean.is_finite() { mean } else { 0.0 };
        sums.iter().zip(&self.views).map(mean).map(finite).collect()
    }
}

impl DensifyRule {
    /// At most `room` rows to be densified, ascending: those of the largest mean gradient, ties by row. `is_small` says
    /// which would be cloned.
    fn selected(&self, sums: &GradientSums, room: usize, is_small: impl Fn(&usize) -> bool) -> Vec<usize> {
        let gradients = sums.means(&sums.signed);
        let absolute = sums.means(&sums.absolute);
        let is_steep = |row: &usize| gradients[*row] >= self.gradient_threshold;
        let absolute_threshold = match self.by_absolute {
            ByAbsolute::Nothing => f64::INFINITY,
            ByAbsolute::Quantile => {
                let steep = (0..gradients.len()).filter(is_steep).count();
                quantile(absolute.clone(), 1.0 - steep as f64 / gradients.len() as f64)
            }
            ByAbsolute::Splits(threshold) => threshold,
        };
        // rows that no view saw have 0, which would pass a threshold of 0
        let is_busy = |row: &usize| absolute[*row] > 0.0 && absolute[*row] >= absolute_threshold;
        let is_chosen = |row: &usize| match self.by_absolute {
            ByAbsolute::Splits(_) if is_small(row) => is_steep(row),
            ByAbsolute::Splits(_) => is_busy(row),
            _ => is_steep(row) || is_busy(row),
        };

        let mut rows: Vec<usize> = (0..gradients.len()).filter(is_chosen).collect();
        rows.sort_by(|a, b| gradients[*b].total_cmp(&gradients[*a]));
        rows.truncate(room);
        // random numbers are drawn in the order of the rows
        rows.sort_unstable();
        rows
    }

    /// Whether no scale of `row` exceeds `limit` (world units). NaN exceeds it.
    fn fits(&self, gaussians: &GaussianData, row: usize, limit: f64) -> bool {
        let axes = if self.flat { 2 } else { 3 };
        gaussians.log_scales[row * 3..][..axes].iter().all(|log_scale| f64::from(*log_scale).exp() <= limit)
    }
}

/// The value below which `fraction` of `values` lie, interpolated between neighbours; infinite without values.
fn quantile(mut values: Vec<f64>, fraction: f64) -> f64 {
    let Some(last) = values.len().checked_sub(1) else { return f64::INFINITY };
    let at = fraction * last as f64;
    let (_, &mut below, above) = values.select_nth_unstable_by(at as usize, f64::total_cmp);
    let above = above.iter().copied().min_by(f64::total_cmp).unwrap_or(below);
    below + at.fract() * (above - below)
}

/// Densifies rows of large mean gradient, at most `room` of them, one more row each, those of the
/// largest mean first. A small one is cloned in place. A large one is replaced by two children at
/// `μ + R · N(0, diag s²)` with its scales / 1.6 and otherwise its parameters. Then old and new rows are pruned (3DGS).
///
/// `extent` in world units; 0, as of a single camera, limits no scale. Opacities are effective, from
/// 0 to 1; `sums` has as many rows as `gaussians`. If no row would be left, nothing changes and a warning is logged.
pub fn densify(
    gaussians: &GaussianData,
    sums: &GradientSums,
    extent: f64,
    rule: &DensifyRule,
    room: usize,
    rng: &mut ChaCha8Rng,
) -> GaussianEdit {
    let count = gaussians.len();
    let limit = |fraction: f64| if extent > 0.0 { fraction * extent } else { f64::INFINITY };
    let max_scale = rule.max_scale_fraction.map_or(f64::INFINITY, limit);
    let stays = |row: usize, max_scale: f64| {
        f64::from(gaussians.opacities[row]) >= rule.min_opacity && rule.fits(gaussians, row, max_scale)
    };

    let is_small = |row: &usize| rule.fits(gaussians, *row, limit(rule.dense_fraction));
    let (mut cloned, parents): (Vec<usize>, Vec<usize>) =
        rule.selected(sums, room, is_small).into_iter().partition(is_small);
    let mut is_parent = vec![false; count];
    parents.iter().for_each(|&row| is_parent[row] = true);
    let keep: Vec<usize> = (0..count).filter(|&row| !is_parent[row] && stays(row, max_scale)).collect();

    // a clone would bring back what is pruned
    cloned.retain(|&row| stays(row, max_scale));
    let mut added = gaussians.select(&cloned);
    if rule.draws_clones {
        draw_positions(&mut added, gaussians, &cloned, rule.flat, rng);
    }
    // children are smaller by as much as the limit is larger
    let fruitful = parents.into_iter().filter(|&row| stays(row, max_scale * SHRINKAGE));
    added.append(children(gaussians, fruitful, rule.flat, rng));

    if count > 0 && keep.is_empty() && added.is_empty() {
        tracing::warn!("densification would prune each of {count} Gaussians: none is changed");
        return GaussianEdit { keep: (0..count).collect(), added };
    }
    GaussianEdit { keep, added }
}

/// Opacities after a reset: each at most `at_most` (3DGS: 0.01 every 3000 steps).
pub fn reset_opacities(opacities: &[f32], at_most: f32) -> Vec<f32> {
    opacities.iter().map(|opacity| opacity.min(at_most)).collect()
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::super::children::vector;
    use super::super::fixtures::{self, MODEL, rng};
    use super::*;

    const RULE: DensifyRule = DensifyRule {
        gradient_threshold: 2e-4,
        by_absolute: ByAbsolute::Nothing,
        dense_fraction: 0.01,
        min_opacity: 0.05,
        max_scale_fraction: None,
        flat: false,
        draws_clones: false,
    };

    /// Gaussians of scales (s, s/2, s/4) turned by 90° about z, so that their long axis is y; their other
    /// numbers tell the rows apart.
    fn gaussians(scales: &[f32]) -> GaussianData {
        let of_axes: Vec<[f32; 3]> = scales.iter().map(|s| [*s, s / 2.0, s / 4.0]).collect();
        fixtures::gaussians(&of_axes, (0..scales.len()).map(|i| 0.5 + 0.125 * (i % 4) as f32).collect())
    }

    /// Sums of two views with the given means.
    fn sums(signed: &[f32], absolute: &[f32]) -> GradientSums {
        let twice = |means: &[f32]| means.iter().map(|mean| 2.0 * mean).collect();
        GradientSums { signed: twice(signed), absolute: twice(absolute), views: vec![2; signed.len()] }
    }

    /// Densification with an extent of 1.
    fn run(gaussians: &GaussianData, signed: &[f32], rule: DensifyRule, room: usize) -> GaussianEdit {
        densify(gaussians, &sums(signed, &vec![0.0; signed.len()]), 1.0, &rule, room, &mut rng(41))
    }

    #[test]
    fn the_small_are_cloned_in_place_or_drawn_from_their_originals() {
        let old = gaussians(&[0.009, 0.005, 0.005]);
        let originals = old.select(&[0, 2]);
        let edit = run(&old, &[3e-4, 1e-4, 2.1e-4], RULE, 9);
        assert_eq!(edit, GaussianEdit { keep: vec![0, 1, 2], added: originals.clone() });
        let edit = run(&old, &[3e-4, 1e-4, 2.1e-4], DensifyRule { draws_clones: true, ..RULE }, 9);
        assert_eq!(GaussianData { positions: originals.positions.clone(), ..edit.added.clone() }, originals);
        for row in 0..2 {
            let distance = (vector(&edit.added.positions, row) - vector(&originals.positions, row)).length();
            assert!(distance > 0.0 && distance < 0.05, "{distance}");
        }
    }

    #[test]
    fn the_large_are_replaced_by_two_smaller() {
        let old = gaussians(&[0.005, 0.02, 0.02]);
        let edit = run(&old, &[0.0, 3e-4, 1e-4], RULE, 9);
        assert_eq!(edit.keep, [0, 2]);
        let parents = old.select(&[1, 1]);
        let GaussianData { positions, quaternions, log_scales, opacities, colour, .. } = edit.added;
        assert_eq!((quaternions, opacities, colour), (parents.quaternions, parents.opacities, parents.colour));
        for (child, parent) in log_scales.iter().zip(&parents.log_scales) {
            assert!((parent.exp() / child.exp() - 1.6).abs() < 1e-5);
        }
        assert_eq!(log_scales.len(), 6);
        assert_ne!(positions[..3], positions[3..]);
        let distance = (vector(&positions, 0) - DVec3::new(3.0, 4.0, 5.0)).length();
        assert!(distance > 0.0 && distance < 0.2, "{distance}");
    }

    #[test]
    fn both_and_pruning_at_once() {
        let mut old = gaussians(&[0.005, 0.02, 0.005, 0.02]);
        (old.opacities[2], old.opacities[3]) = (0.04, 0.04);
        let edit = run(&old, &[3e-4; 4], RULE, 9);
        assert_eq!(edit.keep, [0]);
        assert_eq!(edit.added.opacities, [0.5, 0.625, 0.625]);
        assert_eq!(edit.apply(&old).len(), 4);
    }

    #[test]
    fn gradients_are_means_over_the_views_that_saw_the_row() {
        let sums = GradientSums {
            signed: vec![7e-4, 7e-4, 0.0, 1.0, f32::NAN],
            absolute: vec![0.0; 5],
            views: vec![3, 4, 0, 0, 2],
        };
        let edit = densify(&gaussians(&[0.005; 5]), &sums, 1.0, &RULE, 9, &mut rng(41));
        assert_eq!(edit.added.opacities, [0.5]);
        assert_eq!(edit.keep.len(), 5);
    }

    #[test]
    fn the_faint_and_the_huge_are_pruned() {
        let mut old = gaussians(&[0.09, 0.11, 0.05, 0.005, 0.005]);
        (old.opacities[3], old.opacities[4]) = (0.04, f32::NAN);
        let huge = DensifyRule { max_scale_fraction: Some(0.1), ..RULE };
        assert_eq!(run(&old, &[0.0; 5], RULE, 9).keep, [0, 1, 2]);
        assert_eq!(run(&old, &[0.0; 5], huge, 9).keep, [0, 2]);
        let no_extent = densify(&old, &sums(&[1.0; 5], &[0.0; 5]), 0.0, &huge, 9, &mut rng(41));
        assert_eq!((no_extent.keep, no_extent.added.len()), (vec![0, 1, 2], 3));
    }

    #[test]
    fn children_are_judged_by_their_own_scale() {
        let huge = DensifyRule { max_scale_fraction: Some(0.1), ..RULE };
        let old = gaussians(&[0.15, 0.17, 0.005]);
        let edit = run(&old, &[3e-4, 3e-4, 0.0], huge, 9);
        assert_eq!(edit.keep, [2]);
        assert_eq!(edit.added.opacities, [0.5, 0.5]);
    }

    #[test]
    fn room_goes_to_the_largest_mean_gradients() {
        let old = gaussians(&[0.005, 0.02, 0.005, 0.02]);
        let gradients = [4e-4, 3e-4, 5e-4, 6e-4];
        for room in 0..=5 {
            let edit = run(&old, &gradients, RULE, room);
            assert_eq!(edit.apply(&old).len(), 4 + room.min(4));
        }
        let edit = run(&old, &gradients, RULE, 2);
        assert_eq!((edit.keep, edit.added.opacities), (vec![0, 1, 2], vec![0.75, 0.875, 0.875]));
        assert_eq!(run(&old, &[3e-4; 4], RULE, 1).added.opacities, [0.5]);
    }

    #[test]
    fn quantiles_are_interpolated() {
        let values = vec![5.0, 1.0, 3.0, 2.0, 4.0];
        for (fraction, expected) in [(0.0, 1.0), (0.5, 3.0), (0.8, 4.2), (1.0, 5.0)] {
            assert!((quantile(values.clone(), fraction) - expected).abs() < 1e-12, "{fraction}");
        }
        assert_eq!(quantile(Vec::new(), 0.5), f64::INFINITY);
    }

    #[test]
    fn the_quantile_adds_rows_whose_gradients_cancel_but_no_unseen_ones() {
        // One of five is steep, so that the absolute threshold is the quantile of 0.8: 4.2.
        let sums = sums(&[1e-4, 3e-4, 0.0, 0.0, 0.0], &[5.0, 1.0, 3.0, 2.0, 4.0]);
        let old = gaussians(&[0.005; 5]);
        let by_quantile = DensifyRule { by_absolute: ByAbsolute::Quantile, ..RULE };
        let added = |rule: DensifyRule, room: usize| densify(&old, &sums, 1.0, &rule, room, &mut rng(41)).added;
        assert_eq!(added(RULE, 9), old.select(&[1]));
        assert_eq!(added(by_quantile, 9), old.select(&[0, 1]));
        assert_eq!(added(by_quantile, 1), old.select(&[1]));
        let old = gaussians(&[0.005; 4]);
        assert_eq!(run(&old, &[0.0, 3e-4, 0.0, 0.0], by_quantile, 9).added, old.select(&[1]));
    }

    #[test]
    fn absolute_sums_split_the_large_and_clone_nothing() {
        let rule = DensifyRule { by_absolute: ByAbsolute::Splits(4e-4), dense_fraction: 0.001, ..RULE };
        let sums = sums(&[3e-4, 1e-4, 3e-4, 1e-4], &[5e-4, 5e-4, 3e-4, 5e-4]);
        // small, small, large, large
        let old = gaussians(&[0.0005, 0.0005, 0.005, 0.005]);
        let edit = densify(&old, &sums, 1.0, &rule, 9, &mut rng(41));
        assert_eq!(edit.keep, [0, 1, 2], "the last is split");
        assert_eq!(edit.added.opacities, old.select(&[0, 3, 3]).opacities);
    }

    #[test]
    fn children_are_distributed_as_their_parent() {
        let mut old = gaussians(&[8.0; 10_000]);
        old.positions = [1.0, 2.0, 3.0].repeat(10_000);
        let moments = |flat: bool| {
            let edit = run(&old, &[1.0; 10_000], DensifyRule { flat, ..RULE }, usize::MAX);
            let steps: Vec<DVec3> =
                (0..20_000).map(|row| vector(&edit.added.positions, row) - DVec3::new(1.0, 2.0, 3.0)).collect();
            let mean = |squares: DVec3| squares / steps.len() as f64;
            (mean(steps.iter().sum()), mean(steps.iter().map(|step| *step * *step).sum()))
        };
        let (mean, variance) = moments(false);
        assert!(mean.abs().cmplt(DVec3::new(0.15, 0.3, 0.08)).all(), "{mean}");
        assert!((variance - DVec3::new(16.0, 64.0, 4.0)).abs().cmplt(DVec3::new(0.8, 3.2, 0.2)).all(), "{variance}");
        let (_, in_plane) = moments(true);
        assert!((in_plane - DVec3::new(16.0, 64.0, 0.0)).abs().cmplt(DVec3::new(0.8, 3.2, 1e-9)).all(), "{in_plane}");
    }

    #[test]
    fn the_third_scale_of_a_disc_means_nothing() {
        let mut old = gaussians(&[0.005]);
        old.log_scales[2] = 3.0;
        let huge = DensifyRule { max_scale_fraction: Some(0.1), ..RULE };
        let flat = DensifyRule { flat: true, ..huge };
        assert_eq!(run(&old, &[1.0], flat, 9).added, old);
        assert_eq!(run(&old, &[1.0], RULE, 9).added.len(), 2);
    }

    #[test]
    fn never_all() {
        let mut old = gaussians(&[0.005, 0.02]);
        old.opacities = vec![0.01; 2];
        let edit = run(&old, &[1.0; 2], RULE, 9);
        assert_eq!((edit.keep.len(), edit.added.len()), (2, 0));
        let nothing = GaussianEdit { added: GaussianData::neutral(MODEL, 0), ..GaussianEdit::default() };
        assert_eq!(run(&gaussians(&[]), &[], RULE, 9), nothing);
    }

    #[test]
    fn opacities_are_lowered_never_raised() {
        assert_eq!(reset_opacities(&[0.9, 0.01, 0.003], 0.01), [0.01, 0.01, 0.003]);
    }
}
