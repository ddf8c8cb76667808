//! Opacities and scales of Gaussians, or Student's t kernels, that take the place of one (3DGS-MCMC, DBS, SSS).

use crate::config::Relocation;

/// Largest number of Gaussians that count as sharing one opacity (3DGS-MCMC).
const MAX_COPIES: usize = 51;
/// Smallest opacity after sharing (3DGS-MCMC).
const MIN_OPACITY: f64 = 0.005;
/// Largest opacity after sharing: 1 − ε of `f32` (3DGS-MCMC).
const MAX_OPACITY: f64 = 1.0 - f32::EPSILON as f64;
/// Arguments from which on the series of [`half_step`] is exact to f64.
const SERIES_FROM: f64 = 40.0;

/// Opacity and scale factor of each of `copies` Gaussians (1 to 51, more count as 51) that together
/// replace one of `opacity` o, more than 0 and at most 1 (3DGS-MCMC):
///
/// o' = 1 − (1 − o)^(1/n), s'/s = o / Σ_{i=1..n} Σ_{j=0..i−1} binom(i − 1, j) (−1)^j o'^(j+1) / √(j + 1).
///
/// Afterwards o' is clamped to [0.005, 1 − 1.19e-7]. With [`Relocation::Beta`] the factor is 1. Student's t kernels have
/// [a rule of their own](share_out_students).
pub fn share_out(opacity: f64, copies: usize, kind: Relocation) -> (f64, f64) {
    let copies = copies.clamp(1, MAX_COPIES) as f64;
    // the logarithm of 1 − 1 is infinite
    let opacity = opacity.min(MAX_OPACITY);
    // 1 − (1 − o)^(1/n), which would cancel for a small o
    let shared = -((-opacity).ln_1p() / copies).exp_m1();
    let scale_factor = match kind {
        Relocation::Mcmc => opacity / mass(shared, copies, |k| 1.0 / k.sqrt()),
        Relocation::Beta | Relocation::Student => 1.0,
    };
    (shared.clamp(MIN_OPACITY, MAX_OPACITY), scale_factor)
}

/// The double sum of [`share_out`]. Over i the binomials add up to binom(n, j + 1), which leaves
/// Σ_{k=1..n} binom(n, k) (−1)^(k−1) o'^k f(k), with f(k) = 1 / √k of Gaussians.
pub(super) fn mass(shared: f64, copies: f64, of_power: impl Fn(f64) -> f64) -> f64 {
    let mut binomial_term = -1.0;
    let mut sum = 0.0;
    for k in (1..=copies as usize).map(|k| k as f64) {
        binomial_term *= -shared * (copies - k + 1.0) / k;
        sum += binomial_term * of_power(k);
    }
    sum
}

/// Opacity and scale factor of each of `copies` kernels of Student's t distribution (1 to 51, more count as 51) that together replace one of `opacity`
/// o from −1 to 1, not 0, with ν = `degrees` of freedom (SSS):
///
/// o' = 1 − (1 − o)^(1/n), s'/s = (o B(½, (ν + 2)/2) / Σ_{i=1..n} Σ_{j=0..i−1} binom(i − 1, j) (−1)^j o'^(j+1)
/// B(½, ((j + 1)(ν + 3) − 1)/2))², with the beta function B.
///
/// |o'| is then clamped to [0.005, 1 − 1.19e-7].
pub fn share_out_students(opacity: f64, copies: usize, degrees: f64) -> (f64, f64) {
    let copies = copies.clamp(1, MAX_COPIES) as f64;
    let opacity = opacity.clamp(-MAX_OPACITY, MAX_OPACITY);
    let shared = -((-opacity).ln_1p() / copies).exp_m1();
    // √π, which both betas have, cancels
    let beta = |k: f64| half_step((k * (degrees + 3.0) - 1.0) / 2.0);
    let ratio = opacity * beta(1.0) / mass(shared, copies, beta);
    (shared.abs().clamp(MIN_OPACITY, MAX_OPACITY).copysign(shared), ratio * ratio)
}

/// Γ(x) / Γ(x + ½) of x > 0.
fn half_step(x: f64) -> f64 {
    let mut factor = 1.0;
    let mut at = x;
    while at < SERIES_FROM {
        factor *= (at + 0.5) / at;
        at += 1.0;
    }
    let y = 1.0 / at;
    // Γ(x + ½) / Γ(x) = √x (1 − 1/8x + 1/128x² + 5/1024x³ − 21/32768x⁴ − …)
    let series = 1.0
        + y * (-1.0 / 8.0
            + y * (1.0 / 128.0
                + y * (5.0 / 1024.0 + y * (-21.0 / 32_768.0 + y * (-399.0 / 262_144.0 + y * 869.0 / 4_194_304.0)))));
    factor / (at.sqrt() * series)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn assert_close(found: f64, expected: f64) {
        assert!((found / expected - 1.0).abs() < 1e-12, "{found} instead of {expected}");
    }

    #[test]
    fn the_ratio_of_gamma_functions_is_known_at_halves_and_wholes() {
        let pi = std::f64::consts::PI;
        // Γ(½) = √π, Γ(1) = 1, Γ(3/2) = √π/2
        assert_close(half_step(0.5), pi.sqrt());
        assert_close(half_step(1.0), 2.0 / pi.sqrt());
        assert_close(half_step(50.0) * half_step(50.5), 1.0 / 50.0);
    }

    #[test]
    fn copies_are_as_opaque_as_their_source_whatever_its_sign() {
        for opacity in [-0.95, -0.2, 0.3, 0.999] {
            for copies in [1, 2, 7, 51] {
                let (shared, factor) = share_out_students(opacity, copies, 30.0);
                // too faint ones are made stronger
                if shared.abs() > MIN_OPACITY {
                    assert_close(1.0 - (1.0 - shared).powi(copies as i32), opacity);
                }
                assert!(factor > 0.0 && (copies > 1 || (factor - 1.0).abs() < 1e-12), "{opacity} {copies}: {factor}");
            }
        }
        assert_eq!(share_out_students(0.9, 51, 3.0), share_out_students(0.9, 1000, 3.0));
        assert!(share_out_students(1.0, 3, 3.0).0 < 1.0 && share_out_students(-1.0, 1, 3.0).0 > -1.0);
        assert_eq!(share_out_students(-0.006, 10, 3.0).0, -0.005);
    }

    #[test]
    fn many_degrees_of_freedom_share_as_gaussians_of_squared_factors() {
        for (opacity, copies) in [(0.5, 2), (0.9, 5)] {
            let gaussian = share_out(opacity, copies, Relocation::Mcmc);
            let (shared, factor) = share_out_students(opacity, copies, 1e9);
            assert!((shared - gaussian.0).abs() < 1e-12 && (factor - gaussian.1 * gaussian.1).abs() < 1e-6, "{factor}");
        }
    }
}
