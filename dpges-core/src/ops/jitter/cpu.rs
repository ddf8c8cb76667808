//! CPU kernel: one Gaussian after another, in f64.

use std::f64::consts::TAU;

use burn::backend::TensorMetadata;
use burn::backend::tensor::FloatTensor;
use glam::{DQuat, DVec3};
use rayon::prelude::*;

use super::{JitterInput, JitterOps, JitterOptions, MIN_DEVIATION, NoiseGate};
use crate::backend::host::{self, Host, with_real};
use crate::backend::real::Real;

/// Four pseudorandom words (Jarzynski and Olano 2020, pcg4d).
pub(super) fn hash(words: [u32; 4]) -> [u32; 4] {
    let [mut x, mut y, mut z, mut w] = words.map(|word| word.wrapping_mul(1_664_525).wrapping_add(1_013_904_223));
    for is_last in [false, true] {
        x = x.wrapping_add(y.wrapping_mul(w));
        y = y.wrapping_add(z.wrapping_mul(x));
        z = z.wrapping_add(x.wrapping_mul(y));
        w = w.wrapping_add(y.wrapping_mul(z));
        if !is_last {
            [x, y, z, w] = [x, y, z, w].map(|word| word ^ (word >> 16));
        }
    }
    [x, y, z, w]
}

/// In (0, 1), from the upper 23 bits: exact in f32.
fn uniform(word: u32) -> f64 {
    // the half keeps 0 out, whose logarithm is infinite
    (f64::from(word >> 9) + 0.5) / f64::from(1u32 << 23)
}

/// Three standard normal numbers (Box and Muller).
pub(super) fn normals(words: [u32; 4]) -> DVec3 {
    // the fourth normal number is not needed
    let [a, b, c, d] = words.map(uniform);
    let (first, second) = ((-2.0 * a.ln()).sqrt(), (-2.0 * c.ln()).sqrt());
    DVec3::new(first * (TAU * b).cos(), first * (TAU * b).sin(), second * (TAU * d).cos())
}

impl NoiseGate {
    /// Share of the noise that a Gaussian of `opacity`, from 0 to 1, gets.
    pub(super) fn of(self, opacity: f64) -> f64 {
        match self {
            Self::Mcmc => 1.0 / (1.0 + (100.0 * (opacity - 0.005)).exp()),
            Self::Beta => (1.0 - opacity).max(0.0).powi(100),
        }
    }
}

fn vector<T: Real>(values: &[T], row: usize) -> DVec3 {
    DVec3::from_array([0, 1, 2].map(|axis| values[3 * row + axis].as_f64()))
}

/// World from the axes of a Gaussian; a quaternion of length 0 turns nothing.
fn rotation<T: Real>(quaternions: &[T], row: usize) -> DQuat {
    let [w, x, y, z] = [0, 1, 2, 3].map(|i| quaternions[4 * row + i].as_f64());
    let rotation = DQuat::from_xyzw(x, y, z, w);
    if rotation.length() > 1e-12 { rotation.normalize() } else { DQuat::IDENTITY }
}

impl<B: Host> JitterOps for B {
    fn jitter(input: JitterInput<B>, options: JitterOptions) -> FloatTensor<B> {
        let device = input.positions.device();
        with_real!(input.positions.dtype(), T => {
            let quaternions = host::floats::<B, T>(&input.quaternions);
            let (log_scales, opacities) = (host::floats::<B, T>(&input.log_scales), host::floats::<B, T>(&input.opacities));
            let mut positions = host::floats::<B, T>(&input.positions).into_owned();
            let [seed_low, seed_high] = options.words();
            positions.par_chunks_exact_mut(3).enumerate().for_each(|(row, position)| {
                let opacity = opacities[row].as_f64();
                let strength = options.amount * options.gate.of(opacity);
                let log_scales = vector(&log_scales, row);
                // opaque Gaussians have a closed gate: they do without a hash and logarithms
                if strength * (2.0 * log_scales.max_element()).exp() >= MIN_DEVIATION {
                    let draw = normals(hash([row as u32, 0, seed_low, seed_high]));
                    let rotation = rotation(&quaternions, row);
                    // V ξ = R diag(s²) Rᵀ ξ, from the right, so that V itself is not needed
                    let along_axes = (2.0 * log_scales).exp() * (rotation.conjugate() * draw);
                    let moved = vector(position, 0) + strength * (rotation * along_axes);
                    position.iter_mut().zip(moved.to_array()).for_each(|(x, moved)| *x = T::of(moved));
                }
            });
            let count = positions.len() / 3;
            host::float_tensor::<B, T, 2>(positions, [count, 3], &device)
        })
    }
}
