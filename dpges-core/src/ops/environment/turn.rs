//! The rotation of coefficients of spherical harmonics by small angles.

use std::f64::consts::{FRAC_PI_4, FRAC_PI_8};
use std::sync::LazyLock;

use glam::{DQuat, DVec3};

use crate::ops::colour::cpu::model::harmonics;
use crate::scene::{EnvironmentData, SH_C0};

/// Y0 … Y15.
const ALL: usize = EnvironmentData::coefficient_count(EnvironmentData::MAX_DEGREE);
/// Azimuths of the quadrature, and angles of the differentiation, over a whole turn: harmonics of degree 3 are trigonometric
/// polynomials of degree 3 in either, which 8 samples determine.
const SAMPLES: usize = 8;

/// For each axis the matrix [ALL × ALL] of [`generators`].
static GENERATORS: LazyLock<[[[f64; ALL]; ALL]; 3]> = LazyLock::new(|| DVec3::AXES.map(generator));

/// For each axis of the world a matrix [`count` × `count`], by rows: how fast the first `count` coefficients change, rad⁻¹,
/// of what is seen with them as they were from directions that are turned about the axis. With coefficients c and small
/// angles w it is `E(exp(w) v) = Σ_k (c + Σ_axis w_axis M_axis c)_k Y_k(v)`, to first order.
///
/// # Panics
/// If `count` is more than 16.
pub fn generators(count: usize) -> [Vec<f64>; 3] {
    GENERATORS.each_ref().map(|rows| rows[..count].iter().flat_map(|row| row[..count].to_vec()).collect())
}

fn values(direction: DVec3) -> [f64; ALL] {
    let mut values = [SH_C0; ALL];
    values[1..].copy_from_slice(&harmonics(direction.to_array()));
    values
}

/// `M[i][j] = ∫ Y_i(v) d/dw Y_j(exp(w · axis) v) dv`, since the harmonics are orthonormal.
fn generator(axis: DVec3) -> [[f64; ALL]; ALL] {
    let mut matrix = [[0.0; ALL]; ALL];
    for (z, weight) in gauss_legendre() {
        for azimuth in 0..SAMPLES {
            let (sine, cosine) = (azimuth as f64 * FRAC_PI_4).sin_cos();
            let across = (1.0 - z * z).sqrt();
            let direction = DVec3::new(across * cosine, across * sine, z);
            let (at, slopes) = (values(direction), slopes(axis, direction));
            for (row, y) in matrix.iter_mut().zip(at) {
                for (entry, slope) in row.iter_mut().zip(slopes) {
                    *entry += weight * FRAC_PI_4 * y * slope;
                }
            }
        }
    }
    matrix
}

/// Derivatives of all harmonics at `direction` by the angle that it is turned by about `axis`: those of the trigonometric
/// polynomial through the samples.
fn slopes(axis: DVec3, direction: DVec3) -> [f64; ALL] {
    let mut slopes = [0.0; ALL];
    for sample in 1..SAMPLES {
        let turned = DQuat::from_axis_angle(axis, sample as f64 * FRAC_PI_4) * direction;
        let sign = if sample % 2 == 1 { 0.5 } else { -0.5 };
        let weight = sign / (sample as f64 * FRAC_PI_8).tan();
        slopes.iter_mut().zip(values(turned)).for_each(|(slope, y)| *slope += weight * y);
    }
    slopes
}

/// Four nodes on (−1, 1) and their weights, exact to degree 7.
fn gauss_legendre() -> [(f64, f64); 4] {
    let root = 2.0 / 7.0 * 1.2f64.sqrt();
    let (inner, outer) = ((3.0 / 7.0 - root).sqrt(), (3.0 / 7.0 + root).sqrt());
    let [of_inner, of_outer] = [30f64.sqrt(), -(30f64.sqrt())].map(|root| (18.0 + root) / 36.0);
    [(-outer, of_outer), (-inner, of_inner), (inner, of_inner), (outer, of_outer)]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn turned_directions_see_turned_coefficients() {
        let coefficients: [f64; ALL] = std::array::from_fn(|k| (1.7 * k as f64 + 0.3).sin());
        let seen = |coefficients: &[f64], direction: DVec3| -> f64 {
            coefficients.iter().zip(values(direction)).map(|(c, y)| c * y).sum()
        };
        let step = 1e-5;
        for (axis, generator) in DVec3::AXES.into_iter().zip(generators(ALL)) {
            let slope = |k: usize| -> f64 { (0..ALL).map(|j| generator[k * ALL + j] * coefficients[j]).sum() };
            let changes: Vec<f64> = (0..ALL).map(slope).collect();
            assert!(changes.iter().any(|change| change.abs() > 0.1));
            for direction in [DVec3::new(0.6, -0.3, 0.8), DVec3::new(-0.2, 0.9, -0.4)].map(DVec3::normalize) {
                let at = |angle: f64| seen(&coefficients, DQuat::from_axis_angle(axis, angle) * direction);
                let expected = (at(step) - at(-step)) / (2.0 * step);
                approx::assert_abs_diff_eq!(seen(&changes, direction), expected, epsilon = 1e-8);
            }
        }
    }

    #[test]
    fn fewer_coefficients_have_the_corner_of_the_matrix() {
        let (all, few) = (generators(ALL), generators(4));
        for (all, few) in all.iter().zip(&few) {
            assert_eq!(few.len(), 16);
            assert_eq!(few[4..8], all[ALL..ALL + 4]);
        }
        assert!(generators(1).iter().all(|one| one[0].abs() < 1e-12));
    }
}
