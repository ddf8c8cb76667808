//! Which primitives become one.

use dpges_train::dataset::neighbours::nearest;
use glam::{DMat3, DVec3};
use rayon::prelude::*;

use super::blob::Blob;

/// Neighbours that a primitive may be merged with.
const NEIGHBOURS: usize = 6;
/// Share of the middle size of blobs that a picture of the coarser level does not resolve.
const UNRESOLVED: f64 = 0.5;

/// Puts `blobs` together until no more than `target` are left, those first whose merging changes pictures least: the
/// members of each, in the order of the first. `seen` tells how much a place counts, per world unit².
pub fn clusters(mut blobs: Vec<Blob>, target: usize, seen: impl Fn(DVec3) -> f64 + Sync) -> Vec<Vec<usize>> {
    let mut members: Vec<Vec<usize>> = (0..blobs.len()).map(|row| vec![row]).collect();
    while blobs.len() > target {
        let surplus = blobs.len() - target;
        // Half of what is too much, so that merged ones find new neighbours; in the end all
        let most = if surplus * 8 <= blobs.len() { surplus } else { surplus.div_ceil(2) };
        let partner = matched(&blobs, most, &seen);
        let mut next = (Vec::with_capacity(blobs.len()), Vec::with_capacity(blobs.len()));
        for row in 0..blobs.len() {
            match partner[row] {
                Some(other) if other < row => {}
                Some(other) => {
                    next.0.push(blobs[row].merged(&blobs[other]));
                    let mut both = std::mem::take(&mut members[row]);
                    both.append(&mut members[other]);
                    next.1.push(both);
                }
                None => {
                    next.0.push(blobs[row]);
                    next.1.push(std::mem::take(&mut members[row]));
                }
            }
        }
        (blobs, members) = next;
    }
    members
}

/// The partner of each blob, at most `most` pairs, the cheapest first. There is at least one pair if there are two blobs.
fn matched(blobs: &[Blob], most: usize, seen: &(impl Fn(DVec3) -> f64 + Sync)) -> Vec<Option<usize>> {
    let positions: Vec<[f32; 3]> = blobs.iter().map(|blob| blob.mean.as_vec3().to_array()).collect();
    let near = nearest(&positions, NEIGHBOURS);
    let mut sizes: Vec<f64> = blobs.iter().map(|blob| trace(&blob.covariance)).collect();
    sizes.sort_unstable_by(f64::total_cmp);
    let unresolved = DMat3::from_diagonal(DVec3::splat(UNRESOLVED * UNRESOLVED * sizes[sizes.len() / 2] / 3.0));
    let blurred: Vec<(DMat3, f64)> = blobs
        .par_iter()
        .map(|blob| {
            let covariance = blob.covariance + unresolved;
            (covariance, covariance.determinant().max(f64::MIN_POSITIVE))
        })
        .collect();
    let pairs = |row: usize| {
        let (blurred, near) = (&blurred, &near);
        near[row].iter().map(move |&(other, _)| {
            let other = other as usize;
            let cost = cost([&blobs[row], &blobs[other]], [&blurred[row], &blurred[other]]);
            (cost * seen(blobs[row].mean), row.min(other) as u32, row.max(other) as u32)
        })
    };
    let mut pairs: Vec<(f64, u32, u32)> = (0..blobs.len()).into_par_iter().flat_map_iter(pairs).collect();
    pairs.par_sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)).then(a.2.cmp(&b.2)));
    let mut partner = vec![None; blobs.len()];
    let mut count = 0;
    for (_, a, b) in pairs {
        let (a, b) = (a as usize, b as usize);
        if count < most && partner[a].is_none() && partner[b].is_none() {
            (partner[a], partner[b]) = (Some(b), Some(a));
            count += 1;
        }
    }
    partner
}

fn trace(m: &DMat3) -> f64 {
    m.x_axis.x + m.y_axis.y + m.z_axis.z
}

/// How much a picture changes if two blobs become one, about the integral of the squared difference. It is 0 for blobs that
/// differ only in mass, and grows with what they do not share: the Bhattacharyya coefficient of their spreads is what they do.
fn cost([a, b]: [&Blob; 2], [(of_a, det_a), (of_b, det_b)]: [&(DMat3, f64); 2]) -> f64 {
    let sum = *of_a + *of_b;
    let det = sum.determinant().max(f64::MIN_POSITIVE);
    let apart = b.mean - a.mean;
    let squared = apart.dot(sum.inverse() * apart).max(0.0);
    let shared = (-0.25 * squared).exp() * ((det_a * det_b).sqrt() / (det / 8.0)).sqrt().min(1.0);
    let area = (det / 8.0).cbrt();
    let moved = a.mass * b.mass / (a.mass + b.mass).max(f64::MIN_POSITIVE);
    let unlike = (b.colour - a.colour).length_squared();
    let bright = (1.0 + 0.25 * (a.colour + b.colour).length_squared()) * (1.0 - shared);
    // far apart everything is lost, and a haze is between them besides
    moved * moved / area * (bright + unlike) * (1.0 + squared / 16.0)
}
