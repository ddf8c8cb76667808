//! New Gaussians where the image error is largest (GES, DP-GES).

use std::f32::consts::{PI, TAU};

use dpges_core::scene::{ColourModel, GaussianData, SH_C0};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::normal;
use crate::dataset::neighbours::spacing;

/// Scale of a new Gaussian relative to the root mean square distance to the 3 nearest of its batch (GES).
const SCALE: f32 = 0.5;
/// Linear opacity of a new Gaussian (GES).
const OPACITY: f32 = 0.5;
/// Raw colour of an inconspicuous lobe, of amplitude 0.017 (DP-GES).
const FAINT_LOBE: f32 = -0.3;

/// The size of a batch such that `batches_left` equal batches, this one included, fill the budget.
pub fn batch_size(budget: usize, primitives: usize, batches_left: usize) -> usize {
    budget.saturating_sub(primitives).checked_div(batches_left).unwrap_or(0)
}

/// The size of a batch by which the number of primitives grows by the same factor as by the others, if `batches_left`, this
/// one included, fill the budget. 0 if it is full.
pub fn geometric_batch_size(budget: usize, primitives: usize, batches_left: usize) -> usize {
    if primitives >= budget || batches_left == 0 {
        return 0;
    }
    let from = primitives.max(1) as f64;
    let factor = (budget as f64 / from).powf(1.0 / batches_left as f64);
    ((from * (factor - 1.0)).round() as usize).clamp(1, budget - primitives)
}

/// `count` indices into `weights` (repetitions possible) drawn in proportion to them: pixels to their squared error,
/// Gaussians to their opacity. Weights that are negative or not finite count as 0; if nothing is left, nothing is drawn.
pub fn draw_in_proportion(weights: &[f32], count: usize, rng: &mut ChaCha8Rng) -> Vec<usize> {
    let usable = |weight: &f32| if weight.is_finite() && *weight > 0.0 { f64::from(*weight) } else { 0.0 };
    // in f64: a sum of millions of f32 would lose small weights
    let cumulative: Vec<f64> = weights
        .iter()
        .scan(0.0, |sum, weight| {
            *sum += usable(weight);
            Some(*sum)
        })
        .collect();
    let total = cumulative.last().copied().unwrap_or(0.0);
    if total <= 0.0 {
        return Vec::new();
    }
    let draw = |_| {
        // the product may round up to the total, which lies behind the last entry
        let at = (rng.random::<f64>() * total).min(total.next_down());
        // `<=` passes over entries of weight 0, which repeat the sum before them
        cumulative.partition_point(|&sum| sum <= at)
    };
    (0..count).map(draw).collect()
}

/// One Gaussian at each of `positions` (world units): isotropic, its scale half the root mean square distance to the 3 nearest
/// others (GES), that of one alone `alone` (world units); opacity 0.5, black, faint lobes, a random rotation.
pub fn new_gaussians(positions: &[[f32; 3]], alone: f32, model: ColourModel, rng: &mut ChaCha8Rng) -> GaussianData {
    let count = positions.len();
    let scale = |spacing: Option<f32>| spacing.map_or(alone, |spacing| SCALE * spacing);
    let mut new = GaussianData::neutral(model, count);
    new.positions = positions.as_flattened().to_vec();
    new.quaternions = (0..count).flat_map(|_| random_rotation(rng)).collect();
    new.log_scales = spacing(positions).into_iter().flat_map(|spacing| [scale(spacing).ln(); 3]).collect();
    new.opacities.fill(OPACITY);
    // black: the base colour is 0.5 + C0 k
    new.colour.base.fill((-0.5 / SH_C0) as f32);
    new.colour.detail = faint_detail(model, count, rng);
    new
}

/// Raw colour detail of `count` primitives that look nearly the same from all directions: lobes of amplitude 0.017 in
/// random directions (θ from 0 to π, φ from 0 to 2π, β = 0), or harmonics of 0.
pub fn faint_detail(model: ColourModel, count: usize, rng: &mut ChaCha8Rng) -> Vec<f32> {
    match model {
        ColourModel::SphericalHarmonics { .. } | ColourModel::HarmonicsAndOpacity { .. } => {
            vec![0.0; count * model.detail_len()]
        }
        ColourModel::SphericalBeta { lobes } => (0..count * lobes)
            .flat_map(|_| {
                let (theta, phi) = (PI * rng.random::<f32>(), TAU * rng.random::<f32>());
                [FAINT_LOBE, FAINT_LOBE, FAINT_LOBE, theta, phi, 0.0]
            })
            .collect(),
    }
}

/// A unit quaternion (w, x, y, z), uniform over the rotations.
fn random_rotation(rng: &mut ChaCha8Rng) -> [f32; 4] {
    loop {
        // normal numbers have no preferred direction in four dimensions
        let draw = [0; 4].map(|_| normal(rng));
        let length = draw.iter().map(|x| x * x).sum::<f64>().sqrt();
        if length > 1e-6 {
            return draw.map(|x| (x / length) as f32);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::fixtures::rng;
    use super::*;

    #[test]
    fn batches_fill_the_budget_exactly() {
        let mut primitives = 40;
        for batches_left in (1..=10).rev() {
            primitives += batch_size(1003, primitives, batches_left);
        }
        assert_eq!(primitives, 1003);
        assert_eq!(batch_size(10, 11, 3), 0);
        assert_eq!(batch_size(10, 1, 0), 0);
    }

    #[test]
    fn geometric_batches_grow_with_the_scene_and_fill_the_budget() {
        let mut sizes = vec![100];
        for batches_left in [5, 4, 3, 2, 1] {
            let primitives = *sizes.last().unwrap();
            sizes.push(primitives + geometric_batch_size(3200, primitives, batches_left));
        }
        assert_eq!(sizes, [100, 200, 400, 800, 1600, 3200]);
        assert_eq!(geometric_batch_size(3200, 100, 5), 100);
        assert_eq!(geometric_batch_size(3200, 100, 1), 3100);
        assert_eq!([(10, 10, 3), (10, 11, 3), (10, 1, 0)].map(|(b, p, left)| geometric_batch_size(b, p, left)), [0; 3]);
        assert_eq!((geometric_batch_size(1001, 1000, 10), geometric_batch_size(64, 0, 10)), (1, 1));
    }

    #[test]
    fn pixels_are_drawn_in_proportion_to_their_error() {
        let error = [0.0, 1.0, 3.0, f32::NAN, 0.0, -5.0, 4.0, f32::INFINITY, 0.0];
        let mut counts = [0; 9];
        draw_in_proportion(&error, 80_000, &mut rng(3)).into_iter().for_each(|pixel| counts[pixel] += 1);
        for (pixel, expected) in [(1, 10_000), (2, 30_000), (6, 40_000)] {
            assert!(i32::abs(counts[pixel] - expected) < 600, "{counts:?}");
        }
        assert_eq!(counts.iter().sum::<i32>(), counts[1] + counts[2] + counts[6]);
    }

    #[test]
    fn no_error_draws_nothing() {
        for error in [&[][..], &[0.0; 5], &[f32::NAN, -1.0]] {
            assert!(draw_in_proportion(error, 10, &mut rng(3)).is_empty());
        }
        assert_eq!(draw_in_proportion(&[0.0, f32::MIN_POSITIVE, 0.0], 3, &mut rng(3)), [1, 1, 1]);
    }

    #[test]
    fn new_gaussians_are_black_and_fit_their_batch() {
        let model = ColourModel::SphericalBeta { lobes: 2 };
        let positions = [[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 2.0]];
        let new = new_gaussians(&positions, 0.75, model, &mut rng(3));
        assert_eq!((new.len(), new.colour.detail.len()), (4, 48));
        assert!((new.log_scales[0].exp() - 0.5 * 2f32.sqrt()).abs() < 1e-6);
        assert!((new.log_scales[9].exp() - 0.5 * (14f32 / 3.0).sqrt()).abs() < 1e-6);
        assert!(new.opacities.iter().all(|&opacity| opacity == 0.5));
        assert!((new.colour.base[0] as f64 * SH_C0 + 0.5).abs() < 1e-6);
        let lengths = new.quaternions.as_chunks::<4>().0.iter().map(|q| q.iter().map(|x| x * x).sum::<f32>());
        assert!(lengths.into_iter().all(|length| (length - 1.0).abs() < 1e-5));
        assert_ne!(new.quaternions[..4], new.quaternions[4..8]);
    }

    #[test]
    fn one_alone_and_duplicates_have_a_positive_scale() {
        let model = ColourModel::SphericalHarmonics { degree: 1 };
        let alone = new_gaussians(&[[1.0; 3]], 0.25, model, &mut rng(3));
        assert!((alone.log_scales[0].exp() - 0.25).abs() < 1e-6);
        let twins = new_gaussians(&[[1.0; 3]; 2], 0.25, model, &mut rng(3));
        assert!(twins.log_scales.iter().all(|s| s.is_finite()));
        assert!(new_gaussians(&[], 0.25, model, &mut rng(3)).is_empty());
    }
}
