//! Decisions about the set of primitives, as pure functions on rows.
//!
//! | module | decides |
//! |---|---|
//! | [`prune`] | which primitives stay |
//! | [`floaters`] | which Gaussians float before cameras |
//! | [`split`] | which Gaussians of the joint stage are split |
//! | [`add`] | where new Gaussians are placed |
//! | [`exact_relocation`] | which Gaussians of the joint stage are copied, and which leave for it |
//! | [`margins`] | the depth margins of surfels |
//! | [`densify`] | which discs and Gaussians are cloned, split and pruned |
//! | [`sampling`] | how fine Gaussians may be |
//! | [`mcmc_relocation`] | which Gaussians of MCMC, DBS and SSS are relocated |
//! | [`sharing`] | opacity and scales of several that take the place of one |
//! | [`lobes`], [`growth`], [`layer_count`] | with an automatic budget: lobes to drop, how the number of Gaussians grows, the number of layers |
//!
//! Each returns a plan. A stage applies it to the parameters and to the moments of the optimiser, where new rows start
//! at zero.

pub mod add;
pub mod children;
pub mod densify;
pub mod exact_relocation;
pub mod floaters;
pub mod growth;
pub mod layer_count;
pub mod lobes;
pub mod margins;
pub mod mcmc_relocation;
pub mod prune;
pub mod sampling;
pub mod sharing;
pub mod split;

use std::f64::consts::TAU;

use dpges_core::scene::GaussianData;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

/// Gaussians that are kept, followed by new ones.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct GaussianEdit {
    /// Rows of the old set, ascending.
    pub keep: Vec<usize>,
    pub added: GaussianData,
}

impl GaussianEdit {
    /// The set after the edit: kept rows in their order, then the new ones.
    pub fn apply(&self, gaussians: &GaussianData) -> GaussianData {
        let mut edited = gaussians.select(&self.keep);
        edited.append(self.added.clone());
        edited
    }
}

#[cfg(test)]
mod fixtures {
    use dpges_core::scene::{ColourData, ColourModel, GaussianData};
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    pub const MODEL: ColourModel = ColourModel::SphericalBeta { lobes: 1 };

    pub fn rng(seed: u64) -> ChaCha8Rng {
        ChaCha8Rng::seed_from_u64(seed)
    }

    /// Gaussians of these scales, turned by 90° about z, whose positions and colours tell the rows apart.
    pub fn gaussians(scales: &[[f32; 3]], opacities: Vec<f32>) -> GaussianData {
        let n = scales.len();
        let numbered = |width: usize| (0..n * width).map(|i| i as f32).collect();
        GaussianData {
            positions: numbered(3),
            quaternions: [3.0, 0.0, 0.0, 3.0].repeat(n),
            log_scales: scales.as_flattened().iter().map(|scale| scale.ln()).collect(),
            opacities,
            colour: ColourData::new(MODEL, numbered(3), numbered(6)),
            ..GaussianData::default()
        }
    }
}

/// A standard normal number (Box and Muller).
fn normal(rng: &mut ChaCha8Rng) -> f64 {
    let radius = (-2.0 * (1.0 - rng.random::<f64>()).ln()).sqrt();
    radius * (TAU * rng.random::<f64>()).cos()
}

#[cfg(test)]
mod tests {
    use super::fixtures::{MODEL, rng};
    use super::*;

    #[test]
    fn normal_numbers_have_mean_0_and_variance_1() {
        let mut rng = rng(5);
        let draws: Vec<f64> = (0..40_000).map(|_| normal(&mut rng)).collect();
        let mean = draws.iter().sum::<f64>() / draws.len() as f64;
        let variance = draws.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / draws.len() as f64;
        let within_1 = draws.iter().filter(|x| x.abs() < 1.0).count() as f64 / draws.len() as f64;
        assert!(mean.abs() < 0.02 && (variance - 1.0).abs() < 0.03 && (within_1 - 0.6827).abs() < 0.01);
    }

    #[test]
    fn an_edit_keeps_then_appends() {
        let old = add::new_gaussians(&[[0.0; 3], [1.0; 3], [2.0; 3]], 1.0, MODEL, &mut rng(0));
        let added = add::new_gaussians(&[[9.0; 3]], 1.0, MODEL, &mut rng(0));
        let edit = GaussianEdit { keep: vec![0, 2], added };
        assert_eq!(edit.apply(&old).positions, [0.0, 0.0, 0.0, 2.0, 2.0, 2.0, 9.0, 9.0, 9.0]);
    }
}
