//! Moves faded Gaussians to opaque ones and adds new ones there (3DGS-MCMC, DBS, SSS). A source and its copies share the
//! opacity of the source, so that the picture does not change. The joint stage has
//! [exact relocation](super::exact_relocation) instead.

use dpges_core::scene::GaussianData;
use rand_chacha::ChaCha8Rng;

use super::add::draw_in_proportion;
use super::sharing::{share_out, share_out_students};
use crate::config::Relocation;

/// Largest share of Student's t kernels that is relocated at a time, the weakest (SSS).
const MAX_RELOCATED: f64 = 0.05;

/// The set after relocation and addition: the N old rows in place, then the added ones.
#[derive(Clone, Debug, PartialEq)]
pub struct Relocated {
    /// [N'] the old row of which a row has position, rotation and colour.
    pub rows: Vec<usize>,
    /// [N'] from 0 to 1, or from −1 to 1 for Student's t kernels.
    pub opacities: Vec<f32>,
    /// [N' × 3] natural logarithm of the scales, world units.
    pub log_scales: Vec<f32>,
    /// [N'] rows whose Adam moments become zero: sources and added rows. A relocated row keeps those
    /// of the dead row.
    pub fresh_moments: Vec<bool>,
    pub relocated: usize,
    pub added: usize,
}

impl Relocated {
    /// Gives `sources` (rows, repetitions possible) the opacity and scales of one of as many copies
    /// as they were drawn, and one more.
    fn share(&mut self, sources: &[usize], kind: Relocation, gaussians: &GaussianData) {
        let mut draws = vec![0; self.rows.len()];
        sources.iter().for_each(|&source| draws[source] += 1);
        for (row, &drawn) in draws.iter().enumerate().filter(|(_, drawn)| **drawn > 0) {
            let (opacity, copies) = (f64::from(self.opacities[row]), drawn + 1);
            let (opacity, scale_factor) = match (kind, &gaussians.degrees_of_freedom) {
                (Relocation::Student, Some(degrees)) => {
                    share_out_students(opacity, copies, f64::from(degrees[self.rows[row]]))
                }
                _ => share_out(opacity, copies, kind),
            };
            self.opacities[row] = opacity as f32;
            self.log_scales[row * 3..][..3].iter_mut().for_each(|log_scale| *log_scale += scale_factor.ln() as f32);
            self.fresh_moments[row] = true;
        }
    }

    fn overwrite(&mut self, row: usize, source: usize) {
        self.rows[row] = self.rows[source];
        self.opacities[row] = self.opacities[source];
        self.log_scales.copy_within(source * 3..source * 3 + 3, row * 3);
    }

    fn append(&mut self, source: usize) {
        self.rows.push(self.rows[source]);
        self.opacities.push(self.opacities[source]);
        self.log_scales.extend_from_within(source * 3..source * 3 + 3);
        self.fresh_moments.push(true);
    }
}

/// The number of Gaussians after growing from `count`: `factor` times as many (3DGS-MCMC: 1.05), rounded down, at most
/// `cap` and at least `count`.
pub fn grown(count: usize, factor: f64, cap: usize) -> usize {
    ((count as f64 * factor) as usize).min(cap).max(count)
}

/// Moves the dead (opacity at most `min_opacity`) onto the living, then adds Gaussians until there
/// are `target`. Sources are drawn with replacement in proportion to their opacity, for the addition
/// to that after relocation (3DGS-MCMC).
///
/// For Student's t kernels the absolute values of opacities count, those of exactly `min_opacity` live, and at most 5 % of
/// all, the weakest, are moved at a time (SSS).
///
/// Opacities are effective, from 0 to 1, or from −1 to 1. Without living Gaussians none is relocated. `None` if nothing
/// changes.
pub fn relocate_and_add(
    gaussians: &GaussianData,
    target: usize,
    min_opacity: f64,
    kind: Relocation,
    rng: &mut ChaCha8Rng,
) -> Option<Relocated> {
    let count = gaussians.len();
    let mut result = Relocated {
        rows: (0..count).collect(),
        opacities: gaussians.opacities.clone(),
        log_scales: gaussians.log_scales.clone(),
        fresh_moments: vec![false; count],
        relocated: 0,
        added: 0,
    };

    let is_student = kind == Relocation::Student;
    let is_living = |opacity: f32| {
        let magnitude = f64::from(opacity.abs());
        if is_student { magnitude >= min_opacity } else { f64::from(opacity) > min_opacity }
    };
    let mut dead: Vec<usize> = (0..count).filter(|&row| !is_living(gaussians.opacities[row])).collect();
    if is_student {
        let most = (MAX_RELOCATED * count as f64) as usize;
        // what is no number comes last
        let strength = |&row: &usize| gaussians.opacities[row].abs();
        dead.sort_by(|a, b| strength(a).total_cmp(&strength(b)));
        dead.truncate(most);
    }
    let living = |&opacity: &f32| if is_living(opacity) { opacity.abs() } else { 0.0 };
    let weights: Vec<f32> = gaussians.opacities.iter().map(living).collect();
    let sources = draw_in_proportion(&weights, dead.len(), rng);
    result.relocated = sources.len();
    // before rows are overwritten, so that copies take what their sources have left
    result.share(&sources, kind, gaussians);
    dead.iter().zip(&sources).for_each(|(&row, &source)| result.overwrite(row, source));

    let weights: Vec<f32> = result.opacities.iter().map(|opacity| opacity.abs()).collect();
    let sources = draw_in_proportion(&weights, target.saturating_sub(count), rng);
    result.added = sources.len();
    result.share(&sources, kind, gaussians);
    sources.iter().for_each(|&source| result.append(source));

    (result.relocated + result.added > 0).then_some(result)
}

#[cfg(test)]
mod tests {
    use super::super::fixtures::{self, rng};
    use super::*;
    use crate::refine::sharing::mass;

    fn gaussians(opacities: &[f32]) -> GaussianData {
        fixtures::gaussians(&vec![[1.0, 2.0, 4.0]; opacities.len()], opacities.to_vec())
    }

    fn assert_close(found: f64, expected: f64, tolerance: f64) {
        assert!((found - expected).abs() <= tolerance, "{found} instead of {expected}");
    }

    #[test]
    fn opacity_and_scale_are_those_of_the_published_rule() {
        let cases =
            [(0.5, 2, 0.2929, 0.9522), (0.9, 2, 0.6838, 0.8679), (0.9, 5, 0.3690, 0.7971), (0.99, 10, 0.3690, 0.6674)];
        for (opacity, copies, shared, factor) in cases {
            let found = share_out(opacity, copies, Relocation::Mcmc);
            assert_close(found.0, shared, 6e-5);
            assert_close(found.1, factor, 6e-5);
            assert_eq!(share_out(opacity, copies, Relocation::Beta), (found.0, 1.0));
        }
    }

    #[test]
    fn the_single_sum_is_the_double_sum() {
        let binomial = |n: usize, k: usize| (0..k).map(|i| (n - i) as f64 / (i + 1) as f64).product::<f64>();
        for shared in [0.02f64, 0.13, 0.3] {
            for copies in [1, 2, 5, 17, 51] {
                let term = |i: usize, j: usize| {
                    binomial(i - 1, j) * (-1f64).powi(j as i32) * shared.powi(j as i32 + 1) / ((j + 1) as f64).sqrt()
                };
                let double: f64 = (1..=copies).flat_map(|i| (0..i).map(move |j| (i, j))).map(|(i, j)| term(i, j)).sum();
                assert_close(mass(shared, copies as f64, |k| 1.0 / k.sqrt()) / double, 1.0, 1e-8);
            }
        }
    }

    #[test]
    fn shared_opacities_have_limits() {
        assert_eq!(share_out(0.006, 10, Relocation::Mcmc).0, 0.005);
        let (opaque, factor) = share_out(1.0, 1, Relocation::Mcmc);
        assert!((opaque as f32) < 1.0);
        assert_close(opaque, 1.0 - 1.19e-7, 1e-9);
        assert_close(factor, 1.0, 1e-12);
        assert_eq!(share_out(0.9, 51, Relocation::Mcmc), share_out(0.9, 1000, Relocation::Mcmc));
        assert_ne!(share_out(0.9, 50, Relocation::Mcmc), share_out(0.9, 51, Relocation::Mcmc));
        assert_eq!(share_out(0.5, 0, Relocation::Mcmc), share_out(0.5, 1, Relocation::Mcmc));
    }

    #[test]
    fn growth_ends_at_the_cap() {
        let cases = [(100, 200, 105), (100, 103, 103), (100, 50, 100), (20, 99, 21), (19, 99, 19), (0, 9, 0)];
        for (count, cap, expected) in cases {
            assert_eq!(grown(count, 1.05, cap), expected);
        }
    }

    #[test]
    fn the_dead_become_copies_of_the_living() {
        let old = gaussians(&[0.5, 0.001, 0.9, 0.005, f32::NAN]);
        let new = relocate_and_add(&old, 5, 0.005, Relocation::Mcmc, &mut rng(21)).unwrap();
        assert_eq!((new.relocated, new.added, new.rows.len()), (3, 0, 5));
        assert_eq!((new.rows[0], new.rows[2]), (0, 2));
        for source in [0, 2] {
            let copies: Vec<usize> = (0..5).filter(|&row| new.rows[row] == source).collect();
            let (opacity, factor) = share_out(f64::from(old.opacities[source]), copies.len(), Relocation::Mcmc);
            for &row in &copies {
                assert_close(new.opacities[row].into(), opacity, 1e-6);
                let scales = new.log_scales[row * 3..][..3].iter().map(|s| f64::from(s.exp()) / factor);
                scales.zip([1.0, 2.0, 4.0]).for_each(|(found, expected)| assert_close(found, expected, 1e-5));
            }
            assert_eq!(new.fresh_moments[source], copies.len() > 1);
        }
        assert!([1, 3, 4].iter().all(|&row| [0, 2].contains(&new.rows[row]) && !new.fresh_moments[row]));

        let set = GaussianData {
            opacities: new.opacities.clone(),
            log_scales: new.log_scales.clone(),
            ..old.select(&new.rows)
        };
        let source = new.rows[3];
        assert_eq!(set.positions[9..12], old.positions[source * 3..][..3]);
        assert_eq!(set.colour.detail[18..24], old.colour.detail[source * 6..][..6]);
        assert_eq!((set.opacities, set.log_scales), (new.opacities, new.log_scales));
    }

    #[test]
    fn sources_are_drawn_in_proportion_to_their_opacity() {
        let mut opacities = vec![0.001; 20_002];
        (opacities[0], opacities[20_001]) = (0.2, 0.6);
        let old = gaussians(&opacities);
        let new = relocate_and_add(&old, 0, 0.005, Relocation::Beta, &mut rng(21)).unwrap();
        let from_first = new.rows.iter().filter(|&&row| row == 0).count();
        assert!(from_first.abs_diff(5_001) < 250, "{from_first}");
        assert_eq!(new.relocated, 20_000);
        assert_eq!(new.log_scales, old.log_scales);

        let old = gaussians(&[0.2, 0.6, 0.0]);
        let new = relocate_and_add(&old, 20_003, -1.0, Relocation::Beta, &mut rng(21)).unwrap();
        let from_first = new.rows[3..].iter().filter(|&&row| row == 0).count();
        assert!(from_first.abs_diff(5_000) < 250, "{from_first}");
        assert!(new.rows[3..].iter().all(|&row| row < 2));
    }

    #[test]
    fn added_rows_share_with_their_source() {
        let new = relocate_and_add(&gaussians(&[0.9]), 3, 0.005, Relocation::Mcmc, &mut rng(21)).unwrap();
        let (opacity, factor) = share_out(0.9, 3, Relocation::Mcmc);
        assert_eq!((new.rows, new.fresh_moments, new.relocated, new.added), (vec![0; 3], vec![true; 3], 0, 2));
        new.opacities.iter().for_each(|&found| assert_close(found.into(), opacity, 1e-6));
        new.log_scales.iter().zip([1.0, 2.0, 4.0].repeat(3)).for_each(|(found, scale)| {
            assert_close(found.exp().into(), scale * factor, 1e-5);
        });
    }

    #[test]
    fn additions_see_the_opacities_after_relocation() {
        let new = relocate_and_add(&gaussians(&[0.0, 0.9]), 3, 0.005, Relocation::Mcmc, &mut rng(21)).unwrap();
        assert_eq!((new.relocated, new.added, &new.rows[..]), (1, 1, &[1; 3][..]));
        let (once, factor) = share_out(0.9, 2, Relocation::Mcmc);
        let (twice, factor_again) = share_out(once, 2, Relocation::Mcmc);
        let shared_again = |row: usize| (f64::from(new.opacities[row]) - twice).abs() < 1e-6;
        assert_eq!((0..3).filter(|&row| shared_again(row)).count(), 2);
        assert!(shared_again(2) && new.fresh_moments[1] && new.fresh_moments[2]);
        assert_eq!(new.fresh_moments[0], shared_again(0));
        assert_close(new.log_scales[6].exp().into(), factor * factor_again, 1e-5);
        let other = usize::from(shared_again(0));
        assert_close(new.opacities[other].into(), once, 1e-6);
    }

    #[test]
    fn the_weakest_students_become_copies_of_either_sign() {
        let mut opacities = vec![0.3; 100];
        for (row, opacity) in [(3, 0.001), (4, -0.002), (5, 0.004), (6, -0.0049), (7, 0.003), (8, 0.0035), (9, -0.005)]
        {
            opacities[row] = opacity;
        }
        opacities[0] = -0.9;
        let mut old = gaussians(&opacities);
        old.degrees_of_freedom = Some((0..100).map(|row| 1.0 + row as f32).collect());
        let new = relocate_and_add(&old, 105, 0.005, Relocation::Student, &mut rng(21)).unwrap();
        assert_eq!((new.relocated, new.added, new.rows.len()), (5, 5, 105));
        // six are below the limit, of which the strongest has to wait
        let moved: Vec<usize> = (0..100).filter(|&row| new.rows[row] != row).collect();
        assert_eq!(moved, [3, 4, 5, 7, 8]);
        let mut of_sources: Vec<usize> =
            moved.iter().map(|&row| new.rows[row]).chain(new.rows[100..].to_vec()).collect();
        assert!(of_sources.iter().all(|&row| new.fresh_moments[row] && opacities[row].abs() >= 0.005));
        of_sources.sort_unstable();
        for (row, &source) in new.rows.iter().enumerate() {
            assert_eq!(new.opacities[row] < 0.0, opacities[source] < 0.0, "{row} of {source}");
        }
        let alone = of_sources.iter().filter(|&&row| of_sources.iter().filter(|&&other| other == row).count() == 1);
        let &source = alone.max_by(|a, b| opacities[**a].abs().total_cmp(&opacities[**b].abs())).unwrap();
        let (opacity, factor) = share_out_students(f64::from(opacities[source]), 2, 1.0 + source as f64);
        assert_close(new.opacities[source].into(), opacity, 1e-6);
        assert_close(new.log_scales[3 * source].exp().into(), factor, 1e-5);
    }

    #[test]
    fn nothing_to_do_is_none() {
        let cases =
            [(vec![0.5, 0.3], 2), (vec![0.5, 0.3], 0), (vec![0.001, 0.002], 2), (Vec::new(), 0), (Vec::new(), 9)];
        for (opacities, target) in cases {
            let found = relocate_and_add(&gaussians(&opacities), target, 0.005, Relocation::Mcmc, &mut rng(21));
            assert_eq!(found, None, "{opacities:?}");
        }
    }
}
