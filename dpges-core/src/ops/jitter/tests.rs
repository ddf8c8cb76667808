use std::f64::consts::FRAC_PI_8;

use burn::tensor::{DType, Tensor};
use glam::DVec3;
use rayon::ThreadPoolBuilder;

use super::cpu::{hash, normals};
use super::{JitterOptions, NoiseGate, jitter};
use crate::backend::device::cpu;
use crate::scene::{ColourModel, GaussianData, Gaussians};
use crate::testing::golden::values;

const MCMC: JitterOptions = JitterOptions { gate: NoiseGate::Mcmc, amount: 1.0, seed: 31 };
const BETA: JitterOptions = JitterOptions { gate: NoiseGate::Beta, ..MCMC };

/// Gaussians at (5, 6, 7), turned by 45° about z, of squared scales 1, 3 and 0.5: their covariance is
/// [2 −1 0; −1 2 0; 0 0 0.5].
fn gaussians(opacities: Vec<f32>) -> Gaussians {
    let n = opacities.len();
    let (w, z) = (2.0 * FRAC_PI_8.cos() as f32, 2.0 * FRAC_PI_8.sin() as f32);
    let data = GaussianData {
        positions: [5.0, 6.0, 7.0].repeat(n),
        quaternions: [w, 0.0, 0.0, z].repeat(n),
        log_scales: [1f32, 3.0, 0.5].map(|squared| 0.5 * squared.ln()).repeat(n),
        opacities,
        ..GaussianData::neutral(ColourModel::default(), n)
    };
    Gaussians::from_data(&data, &cpu(), DType::F64)
}

/// How far each row moves.
fn steps(gaussians: &Gaussians, options: JitterOptions) -> Vec<DVec3> {
    let moved: Tensor<2> = jitter(gaussians, &options).unwrap();
    let rows = values(&moved);
    rows.chunks(3).map(|row| DVec3::from_slice(row) - DVec3::new(5.0, 6.0, 7.0)).collect()
}

fn mean(steps: &[DVec3], value: impl Fn(&DVec3) -> f64) -> f64 {
    steps.iter().map(value).sum::<f64>() / steps.len() as f64
}

#[test]
fn gates_fade_as_published() {
    for (opacity, mcmc, beta) in
        [(0.005, 0.5, 0.606), (0.01, 0.378, 0.366), (0.05, 0.011, 5.9e-3), (0.1, 7.5e-5, 2.66e-5)]
    {
        assert!((NoiseGate::Mcmc.of(opacity) / mcmc - 1.0).abs() < 0.02, "{opacity}");
        assert!((NoiseGate::Beta.of(opacity) / beta - 1.0).abs() < 0.02, "{opacity}");
    }
    assert_eq!((NoiseGate::Beta.of(0.0), NoiseGate::Beta.of(1.0)), (1.0, 0.0));
}

#[test]
fn displacements_have_the_covariance_squared() {
    // The gate is 0.5, so that the noise is V ξ and its covariance V².
    let steps = steps(&gaussians(vec![0.005; 30_000]), JitterOptions { amount: 2.0, ..MCMC });
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
fn draws_of_neighbouring_rows_and_seeds_are_not_correlated() {
    let draws: Vec<DVec3> = (0..40_000).map(|row| normals(hash([row, 0, 7, 9]))).collect();
    let next_seed: Vec<DVec3> = (0..40_000).map(|row| normals(hash([row, 0, 8, 9]))).collect();
    let lagged = draws.windows(2).map(|pair| pair[0] * pair[1]).sum::<DVec3>() / 40_000.0;
    let across = draws.iter().zip(&next_seed).map(|(a, b)| *a * *b).sum::<DVec3>() / 40_000.0;
    assert!(lagged.abs().max_element() < 0.025 && across.abs().max_element() < 0.025, "{lagged} {across}");
    assert!(draws.iter().all(|draw| draw.is_finite()));
    assert!((mean(&draws, |d| d.x.powi(4)) - 3.0).abs() < 0.2);
}

#[test]
fn noise_is_proportional_to_gate_and_amount() {
    let step = |opacity: f32, options| steps(&gaussians(vec![opacity]), options)[0];
    let whole = step(0.0, BETA);
    assert!(whole.length() > 1e-2);
    let gated = step(0.01, JitterOptions { amount: 3.0, ..BETA });
    assert!((gated - 3.0 * 0.99f64.powi(100) * whole).length() < 1e-5);
    assert!((step(0.005, MCMC) - 0.5 * whole).length() < 1e-5);
}

#[test]
fn the_opaque_stay() {
    let opaque = gaussians(vec![0.9; 5]);
    for options in [MCMC, BETA] {
        let options = JitterOptions { amount: 1e3, ..options };
        assert!(steps(&opaque, options).iter().all(|step| *step == DVec3::ZERO));
    }
    assert!(steps(&gaussians(Vec::new()), BETA).is_empty());
}

#[test]
fn rows_and_seeds_differ_and_threads_do_not_matter() {
    let old = gaussians(vec![0.0; 700]);
    let with_threads = |count| {
        let pool = ThreadPoolBuilder::new().num_threads(count).build().unwrap();
        pool.install(|| steps(&old, BETA))
    };
    let moved = with_threads(1);
    assert_eq!(moved, with_threads(3));
    assert!(moved.windows(2).all(|pair| pair[0] != pair[1]));
    for seed in [32, 31 + (1 << 32)] {
        let other = steps(&old, JitterOptions { seed, ..BETA });
        assert!(moved.iter().zip(&other).all(|(a, b)| a != b));
    }
}
