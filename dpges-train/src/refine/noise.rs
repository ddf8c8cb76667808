//! Noise on the places of faint Gaussians, along their own extent, so that they explore the scene
//! (3DGS-MCMC, DBS).

use dpges_core::scene::GaussianData;
use glam::{DVec3, Vec3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

use super::children::{rotation, vector};
use super::normal;

/// Rows that draw from one stream of random numbers, so that the number of threads does not matter.
const ROWS_PER_STREAM: usize = 256;
/// World units; Gaussians whose standard deviation of noise is below this stay where they are.
const MIN_DEVIATION: f64 = 1e-12;

/// How noise fades with opacity.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Noise {
    /// 1 / (1 + exp(−100 ((1 − o) − 0.995))) (3DGS-MCMC).
    Mcmc,
    /// (1 − o)^100 (DBS).
    Beta,
}

impl Noise {
    /// Share of the noise that a Gaussian of `opacity`, from 0 to 1, gets.
    fn gate(self, opacity: f64) -> f64 {
        match self {
            Self::Mcmc => 1.0 / (1.0 + (100.0 * (opacity - 0.005)).exp()),
            Self::Beta => (1.0 - opacity).max(0.0).powi(100),
        }
    }
}

/// Positions [N × 3], world units, with noise: μ + V (ξ · gate(o) · `amount`), where ξ is standard
/// normal and V = R diag(s²) Rᵀ the covariance (3DGS-MCMC).
///
/// `amount` is 5e5 (3DGS-MCMC) or 5e4 (DBS) times the learning rate of positions in world units.
/// Opacities are effective, from 0 to 1. One number is taken from `rng`; the result does not depend
/// on the number of threads.
pub fn jitter(gaussians: &GaussianData, kind: Noise, amount: f64, rng: &mut ChaCha8Rng) -> Vec<f32> {
    let first_stream = ChaCha8Rng::seed_from_u64(rng.random());
    let mut positions = gaussians.positions.clone();
    positions.par_chunks_mut(3 * ROWS_PER_STREAM).enumerate().for_each(|(stream, chunk)| {
        let mut rng = first_stream.clone();
        rng.set_stream(stream as u64);
        for (at, position) in chunk.as_chunks_mut::<3>().0.iter_mut().enumerate() {
            let row = stream * ROWS_PER_STREAM + at;
            let strength = amount * kind.gate(f64::from(gaussians.opacities[row]));
            let log_scales = vector(&gaussians.log_scales, row);
            if strength * (2.0 * log_scales.max_element()).exp() >= MIN_DEVIATION {
                let draw = DVec3::new(normal(&mut rng), normal(&mut rng), normal(&mut rng));
                let rotation = rotation(gaussians, row);
                let along_axes = (2.0 * log_scales).exp() * (rotation.conjugate() * draw);
                let moved = Vec3::from_array(*position).as_dvec3() + strength * (rotation * along_axes);
                *position = moved.as_vec3().to_array();
            }
        }
    });
    positions
}

#[cfg(test)]
mod tests {
    use std::f64::consts::FRAC_PI_8;

    use dpges_core::scene::ColourData;
    use rayon::ThreadPoolBuilder;

    use super::*;

    /// Gaussians at (5, 6, 7), turned by 45° about z, of squared scales 1, 3 and 0.5: their covariance is
    /// [2 −1 0; −1 2 0; 0 0 0.5].
    fn gaussians(opacities: Vec<f32>) -> GaussianData {
        let n = opacities.len();
        let (w, z) = (2.0 * FRAC_PI_8.cos() as f32, 2.0 * FRAC_PI_8.sin() as f32);
        GaussianData {
            positions: [5.0, 6.0, 7.0].repeat(n),
            quaternions: [w, 0.0, 0.0, z].repeat(n),
            log_scales: [1f32, 3.0, 0.5].map(|squared| 0.5 * squared.ln()).repeat(n),
            opacities,
            colour: ColourData::default(),
        }
    }

    fn rng() -> ChaCha8Rng {
        ChaCha8Rng::seed_from_u64(31)
    }

    fn mean(steps: &[DVec3], value: impl Fn(&DVec3) -> f64) -> f64 {
        steps.iter().map(value).sum::<f64>() / steps.len() as f64
    }

    #[test]
    fn gates_fade_as_published() {
        for (opacity, mcmc, beta) in
            [(0.005, 0.5, 0.606), (0.01, 0.378, 0.366), (0.05, 0.011, 5.9e-3), (0.1, 7.5e-5, 2.66e-5)]
        {
            assert!((Noise::Mcmc.gate(opacity) / mcmc - 1.0).abs() < 0.02, "{opacity}");
            assert!((Noise::Beta.gate(opacity) / beta - 1.0).abs() < 0.02, "{opacity}");
        }
        assert_eq!((Noise::Beta.gate(0.0), Noise::Beta.gate(1.0)), (1.0, 0.0));
    }

    #[test]
    fn displacements_have_the_covariance_squared() {
        // The gate is 0.5, so that the noise is V ξ and its covariance V².
        let moved = jitter(&gaussians(vec![0.005; 30_000]), Noise::Mcmc, 2.0, &mut rng());
        let steps: Vec<DVec3> = (0..30_000).map(|row| vector(&moved, row) - DVec3::new(5.0, 6.0, 7.0)).collect();
        let found = [
            (mean(&steps, |d| d.x), 0.0),
            (mean(&steps, |d| d.y), 0.0),
            (mean(&steps, |d| d.z), 0.0),
            (mean(&steps, |d| d.x * d.x), 5.0),
            (mean(&steps, |d| d.y * d.y), 5.0),
            (mean(&steps, |d| d.z * d.z), 0.25),
            (mean(&steps, |d| d.x * d.y), -4.0),
            (mean(&steps, |d| d.x * d.z), 0.0),
            (mean(&steps, |d| d.y * d.z), 0.0),
        ];
        assert!(found.iter().all(|(found, expected)| (found - expected).abs() < 0.2), "{found:?}");
        assert!((mean(&steps, |d| d.z * d.z) - 0.25).abs() < 0.012);
    }

    #[test]
    fn noise_is_proportional_to_gate_and_amount() {
        let step = |opacity: f32, kind, amount| {
            let moved = jitter(&gaussians(vec![opacity]), kind, amount, &mut rng());
            vector(&moved, 0) - DVec3::new(5.0, 6.0, 7.0)
        };
        let whole = step(0.0, Noise::Beta, 1.0);
        assert!(whole.length() > 1e-2);
        assert!((step(0.01, Noise::Beta, 3.0) - 3.0 * 0.99f64.powi(100) * whole).length() < 1e-5);
        assert!((step(0.005, Noise::Mcmc, 1.0) - 0.5 * whole).length() < 1e-5);
    }

    #[test]
    fn the_opaque_stay() {
        let old = gaussians(vec![0.9; 5]);
        assert_eq!(jitter(&old, Noise::Mcmc, 1e3, &mut rng()), old.positions);
        assert_eq!(jitter(&old, Noise::Beta, 1e3, &mut rng()), old.positions);
        assert!(jitter(&gaussians(Vec::new()), Noise::Beta, 1.0, &mut rng()).is_empty());
    }

    #[test]
    fn rows_draws_and_streams_differ_and_threads_do_not_matter() {
        let old = gaussians(vec![0.0; 3 * ROWS_PER_STREAM + 7]);
        let with_threads = |count| {
            let pool = ThreadPoolBuilder::new().num_threads(count).build().unwrap();
            pool.install(|| jitter(&old, Noise::Beta, 1.0, &mut rng()))
        };
        let moved = with_threads(1);
        assert_eq!(moved, with_threads(3));
        let row = |row: usize| &moved[row * 3..][..3];
        assert_ne!(row(0), row(1));
        assert_ne!(row(0), row(ROWS_PER_STREAM));
        assert_ne!(row(ROWS_PER_STREAM), row(2 * ROWS_PER_STREAM));

        let mut rng = rng();
        assert_eq!(jitter(&old, Noise::Beta, 1.0, &mut rng), moved);
        assert_ne!(jitter(&old, Noise::Beta, 1.0, &mut rng), moved);
    }
}
