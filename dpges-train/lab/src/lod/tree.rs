//! Cells of about the same number of primitives each, by content: halves of halves.

use dpges_core::scene::SceneData;
use dpges_train::dataset::neighbours::as_points;
use glam::DVec3;

/// Primitives whose spread decides along which axis a part is halved.
const SAMPLE: usize = 1024;

/// Rows of surfels, and of Gaussians, of a cell, ascending.
pub type Rows = [Vec<usize>; 2];

/// The leaves of a tree in which every cell with children has two: 2^depth cells of at most `most` primitives, each primitive
/// of `scene` in one of them. Siblings follow each other, so that the parents of leaves 2 k and 2 k + 1 are the k-th cells
/// above them, up to the root. A part is halved at its median along the axis on which the middle half of it is longest.
pub fn leaves(scene: &SceneData, most: usize) -> Vec<Rows> {
    let surfels = as_points(&scene.surfels.positions);
    let points: Vec<&[f32; 3]> = surfels.iter().chain(as_points(&scene.gaussians.positions)).collect();
    let mut ids: Vec<u32> = (0..points.len() as u32).collect();
    let depth = points.len().div_ceil(most.max(1)).max(1).next_power_of_two().ilog2();
    let mut parts = vec![&mut ids[..]];
    for _ in 0..depth {
        use rayon::prelude::*;
        parts = parts.into_par_iter().flat_map_iter(|part| halves(part, &points)).collect();
    }
    let rows = |part: &mut [u32]| {
        part.sort_unstable();
        let (of_surfels, of_gaussians) = part.split_at(part.partition_point(|&id| (id as usize) < surfels.len()));
        [
            of_surfels.iter().map(|&id| id as usize).collect(),
            of_gaussians.iter().map(|&id| id as usize - surfels.len()).collect(),
        ]
    };
    parts.into_iter().map(rows).collect()
}

fn halves<'a>(part: &'a mut [u32], points: &[&[f32; 3]]) -> [&'a mut [u32]; 2] {
    let middle = part.len() / 2;
    if middle > 0 {
        let [low, high] = quantiles(part.iter().map(|&id| points[id as usize]), part.len(), [0.25, 0.75]);
        let axis = (high - low).as_vec3().max_position();
        let coordinate = |id: &u32| points[*id as usize][axis];
        part.select_nth_unstable_by(middle, |a, b| coordinate(a).total_cmp(&coordinate(b)).then(a.cmp(b)));
    }
    part.split_at_mut(middle).into()
}

/// Of a sample of `count` points, the corners at two `shares` of all, along every axis by itself.
pub fn quantiles<'a>(points: impl Iterator<Item = &'a [f32; 3]>, count: usize, shares: [f64; 2]) -> [DVec3; 2] {
    let sample: Vec<&[f32; 3]> = points.step_by(count.div_ceil(SAMPLE).max(1)).collect();
    let mut corners = [DVec3::ZERO; 2];
    for axis in 0..3 {
        let mut along: Vec<f32> = sample.iter().map(|point| point[axis]).collect();
        along.sort_unstable_by(f32::total_cmp);
        for (corner, share) in corners.iter_mut().zip(shares) {
            let at = (share * along.len().saturating_sub(1) as f64).round() as usize;
            corner[axis] = along.get(at).copied().unwrap_or(0.0).into();
        }
    }
    corners
}
