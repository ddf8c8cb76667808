//! GPU kernel: one unit per Gaussian.

use burn::backend::TensorMetadata;
use burn::backend::tensor::FloatTensor;
use burn_cubecl::CubeBackend;
use cubecl::prelude::*;

use super::{JitterInput, JitterOps, JitterOptions, MIN_DEVIATION, NoiseGate};
use crate::gpu::launch::{buffer, cube_dim, empty_f32, floats, units};
use crate::gpu::vector::{Vec3, add, apply, rotation, row3, row4, scale, sin_cos, transpose, vec3, write3};

#[derive(CubeType, CubeLaunch, Clone, Copy)]
#[expand(derive(Clone, Copy))]
struct Noise {
    amount: f32,
    seed_low: u32,
    seed_high: u32,
    count: u32,
}

#[derive(CubeType, Clone, Copy)]
#[expand(derive(Clone, Copy))]
struct Words {
    x: u32,
    y: u32,
    z: u32,
    w: u32,
}

#[cube]
fn mixed(v: Words) -> Words {
    let x = v.x + v.y * v.w;
    let y = v.y + v.z * x;
    let z = v.z + x * y;
    Words { x, y, z, w: v.w + y * z }
}

/// Four pseudorandom words (Jarzynski and Olano 2020, pcg4d).
#[cube]
fn hash(row: u32, seed_low: u32, seed_high: u32) -> Words {
    let first = mixed(Words {
        // unsigned numbers wrap around on devices, as the CPU's `wrapping_mul` does
        x: row * 1_664_525u32 + 1_013_904_223u32,
        y: 1_013_904_223u32.runtime(),
        z: seed_low * 1_664_525u32 + 1_013_904_223u32,
        w: seed_high * 1_664_525u32 + 1_013_904_223u32,
    });
    mixed(Words {
        x: first.x ^ (first.x >> 16u32),
        y: first.y ^ (first.y >> 16u32),
        z: first.z ^ (first.z >> 16u32),
        w: first.w ^ (first.w >> 16u32),
    })
}

/// In (0, 1), from the upper 23 bits: exact in f32.
#[cube]
fn uniform(word: u32) -> f32 {
    (f32::cast_from(word >> 9u32) + 0.5f32) * 1.192_092_9e-7f32
}

/// Three standard normal numbers (Box and Muller).
#[cube]
fn normals(words: Words) -> Vec3 {
    let first = f32::sqrt(-2.0f32 * f32::ln(uniform(words.x)));
    let second = f32::sqrt(-2.0f32 * f32::ln(uniform(words.z)));
    let (sine, cosine) = sin_cos(uniform(words.y) * std::f32::consts::TAU);
    let (_sine, other) = sin_cos(uniform(words.w) * std::f32::consts::TAU);
    vec3(first * cosine, first * sine, second * other)
}

/// Share of the noise that a Gaussian of `opacity`, from 0 to 1, gets.
#[cube]
fn gated(opacity: f32, #[comptime] gate: NoiseGate) -> f32 {
    match gate {
        // e⁸⁸ is about the largest f32
        NoiseGate::Mcmc => 1.0f32 / (1.0f32 + f32::exp(min(100.0f32 * (opacity - 0.005f32), 80.0f32))),
        // a power by its logarithm, which 0 does not have
        NoiseGate::Beta => f32::exp(100.0f32 * f32::ln(max(1.0f32 - opacity, 1e-30f32))),
    }
}

#[cube(launch)]
fn jitter_kernel(
    positions: &[f32],
    quaternions: &[f32],
    log_scales: &[f32],
    opacities: &[f32],
    out: &mut [f32],
    noise: Noise,
    #[comptime] gate: NoiseGate,
) {
    let i = ABSOLUTE_POS;
    if i >= noise.count as usize {
        terminate!();
    }
    let position = row3(positions, i);
    let scales = row3(log_scales, i);
    let squared = vec3(f32::exp(2.0f32 * scales.x), f32::exp(2.0f32 * scales.y), f32::exp(2.0f32 * scales.z));
    let strength = noise.amount * gated(opacities[i], gate);
    // opaque Gaussians have a closed gate: they do without a hash and logarithms
    if strength * max(squared.x, max(squared.y, squared.z)) >= MIN_DEVIATION as f32 {
        let frame = rotation(row4(quaternions, i));
        let draw = normals(hash(i as u32, noise.seed_low, noise.seed_high));
        let along = apply(transpose(frame), draw);
        let step = apply(frame, vec3(squared.x * along.x, squared.y * along.y, squared.z * along.z));
        write3(out, i, add(position, scale(step, strength)));
    } else {
        write3(out, i, position);
    }
}

impl JitterOps for CubeBackend {
    fn jitter(input: JitterInput<Self>, options: JitterOptions) -> FloatTensor<Self> {
        let [positions, quaternions, log_scales, opacities] =
            [input.positions, input.quaternions, input.log_scales, input.opacities].map(floats);
        let count = positions.shape()[0];
        let out = empty_f32(&positions, [count, 3]);
        if count > 0 {
            let [seed_low, seed_high] = options.words();
            let noise = NoiseLaunch::new(options.amount as f32, seed_low, seed_high, count as u32);
            jitter_kernel::launch(
                &out.client.clone(),
                units(count),
                cube_dim(),
                buffer(&positions),
                buffer(&quaternions),
                buffer(&log_scales),
                buffer(&opacities),
                buffer(&out),
                noise,
                options.gate,
            );
        }
        out
    }
}
