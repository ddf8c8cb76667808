//! Half as many primitives for the same picture from farther away.

use dpges_core::scene::{ColourData, GaussianData, SH_C0, SurfelData};
use glam::{DMat3, DQuat, DVec3};

use super::blob::{Blob, covariance, mean_area};
use super::colours::append_mean;
use super::pairs::clusters;

/// Half of `gaussians`, rounded up. Their sums need no order: the integral over a picture of the weight, o × the projected
/// area in the mean over all directions, and that of colour times weight stay, and so do mean and covariance of the weight.
/// `seen` tells how much a place counts, per world unit².
pub fn half_of_gaussians(gaussians: &GaussianData, seen: impl Fn(DVec3) -> f64 + Sync) -> GaussianData {
    let blob = |row: usize| {
        let sigmas = sigmas::<3>(&gaussians.log_scales, row);
        let mass = f64::from(gaussians.opacities[row].max(0.0)) * mean_area(sigmas);
        blob(mass, &gaussians.positions, &gaussians.quaternions, &gaussians.colour, row, sigmas.into())
    };
    let blobs: Vec<Blob> = (0..gaussians.len()).map(blob).collect();
    let mut half = gaussians.select(&[]);
    for members in clusters(blobs.clone(), gaussians.len().div_ceil(2), seen) {
        let Some(whole) = whole(&blobs, &members) else {
            half.append(gaussians.select(&members));
            continue;
        };
        let (variances, frame) = whole.axes();
        let sigmas = variances.map(f64::sqrt);
        half.positions.extend(whole.mean.as_vec3().to_array());
        half.quaternions.extend(quaternion(frame));
        half.log_scales.extend(sigmas.map(log));
        half.opacities.push((whole.mass / mean_area(sigmas)) as f32);
        append_mean(&mut half.colour, &gaussians.colour, &shares(&blobs, &members));
    }
    half
}

/// Half of `surfels`, rounded up, each a disc that covers what its members cover. `modulation`: w of the scene.
pub fn half_of_surfels(surfels: &SurfelData, modulation: f64, seen: impl Fn(DVec3) -> f64 + Sync) -> SurfelData {
    // min(1, w G) is opaque up to r = σ √(2 ln w), and the variance of a disc is r² / 4 along each of its axes
    let spread = (modulation.max(1.0).ln() / 2.0).max(1.0).sqrt();
    let blob = |row: usize| {
        let [a, b] = sigmas::<2>(&surfels.log_scales, row).map(|sigma| spread * sigma);
        blob(a * b, &surfels.positions, &surfels.quaternions, &surfels.colour, row, DVec3::new(a, b, 0.0))
    };
    let blobs: Vec<Blob> = (0..surfels.len()).map(blob).collect();
    let mut half = surfels.select(&[]);
    for members in clusters(blobs.clone(), surfels.len().div_ceil(2), seen) {
        let Some(whole) = whole(&blobs, &members) else {
            half.append(surfels.select(&members));
            continue;
        };
        let ([a, b, across], frame) = whole.axes();
        let shares = shares(&blobs, &members);
        half.positions.extend(whole.mean.as_vec3().to_array());
        half.quaternions.extend(quaternion(frame));
        half.log_scales.extend([a, b].map(|variance| log(variance.sqrt() / spread)));
        // the disc leaves out how far its members are before and behind it, and Gaussians before them are not hidden
        let margin: f64 = shares.iter().map(|&(row, share)| share * f64::from(surfels.margins[row])).sum();
        half.margins.push((margin + across.sqrt()) as f32);
        append_mean(&mut half.colour, &surfels.colour, &shares);
    }
    half
}

/// All `members` in one; `None` for a member alone.
fn whole(blobs: &[Blob], members: &[usize]) -> Option<Blob> {
    let [first, others @ ..] = members else { return None };
    let whole = others.iter().fold(blobs[*first], |whole, &other| whole.merged(&blobs[other]));
    (!others.is_empty()).then_some(whole)
}

/// Share of each of `members` in the mass of all.
fn shares(blobs: &[Blob], members: &[usize]) -> Vec<(usize, f64)> {
    let mass: f64 = members.iter().map(|&row| blobs[row].mass).sum();
    let share = |row: usize| if mass > 0.0 { blobs[row].mass / mass } else { 1.0 / members.len() as f64 };
    members.iter().map(|&row| (row, share(row))).collect()
}

fn blob(mass: f64, positions: &[f32], quaternions: &[f32], colour: &ColourData, row: usize, sigmas: DVec3) -> Blob {
    let numbers = |values: &[f32]| DVec3::new(values[0].into(), values[1].into(), values[2].into());
    let [w, x, y, z] = std::array::from_fn(|at| f64::from(quaternions[4 * row + at]));
    let turn = DQuat::from_xyzw(x, y, z, w);
    let frame = if turn.length_squared() > 0.0 { DMat3::from_quat(turn.normalize()) } else { DMat3::IDENTITY };
    Blob {
        mass,
        mean: numbers(&positions[3 * row..]),
        covariance: covariance(frame, sigmas),
        colour: 0.5 + SH_C0 * numbers(&colour.base[3 * row..]),
    }
}

fn sigmas<const N: usize>(log_scales: &[f32], row: usize) -> [f64; N] {
    std::array::from_fn(|axis| f64::from(log_scales[N * row + axis]).exp())
}

/// A scale of zero has no logarithm.
fn log(sigma: f64) -> f32 {
    sigma.max(f64::from(f32::MIN_POSITIVE)).ln() as f32
}

fn quaternion(frame: DMat3) -> [f32; 4] {
    let turn = DQuat::from_mat3(&frame);
    [turn.w, turn.x, turn.y, turn.z].map(|number| number as f32)
}
