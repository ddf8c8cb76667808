//! The Gaussians that a camera sees, neighbours in the image beside one another.

use std::ops::Range;

use pulp::{Simd, WithSimd};
use rayon::prelude::*;

use super::Splat;
use crate::backend::real::Real;
use crate::backend::vectorised::vectorised;
use crate::backend::vectors::MOST;
use crate::footprint::gaussian::tensors::GaussianRows;
use crate::math::CameraOf;
use crate::scene::ScreenFilter;
use crate::tiles::{PixelRect, TileGrid};

/// Gaussians projected by one task.
const CHUNK: usize = 1024;
/// Stands for the place of a Gaussian that is not seen.
pub const UNSEEN: u32 = u32::MAX;

/// Gaussians after culling, by the tile in which their rectangle begins. Neighbours in the image are neighbours in
/// memory: the sums of neighbours are in a cache that those of the whole image do not fit in.
pub struct InView<T> {
    /// Row of each in the parameters.
    pub rows: Vec<u32>,
    pub splats: Vec<Splat<T>>,
    pub rects: Vec<PixelRect>,
}

/// Projects the Gaussians of a chunk: the tile in which each begins, its row, its footprint and its rectangle.
struct Project<'a, T: Real> {
    gaussians: &'a GaussianRows<'a, T>,
    camera: &'a CameraOf<T>,
    filter: ScreenFilter,
    grid: TileGrid,
    rows: Range<usize>,
}

impl<T: Real> WithSimd for Project<'_, T> {
    type Output = Vec<(usize, u32, Splat<T>, PixelRect)>;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> Self::Output {
        let Self { gaussians, camera, filter, grid, rows } = self;
        let camera = camera.in_lanes(simd);
        let mut seen = Vec::with_capacity(rows.len());
        for first in rows.clone().step_by(T::lane_count::<S>()) {
            // the last row again in lanes that are left over
            let lanes: [usize; MOST] = std::array::from_fn(|lane| (first + lane).min(rows.end - 1));
            let parameters = gaussians.parameters_in_lanes(simd, &lanes);
            let (visible, splats) = Splat::seen(&camera, &parameters, gaussians.colours_in_lanes(simd, &lanes), filter);
            for (row, splat) in (first..rows.end).zip(splats.apart(visible)) {
                let Some(splat) = splat else { continue };
                let rect = splat.reach(grid.width, grid.height);
                let [column, _, line, _] = rect.tiles();
                if !rect.is_empty() {
                    seen.push((line * grid.columns + column, row as u32, splat, rect));
                }
            }
        }
        seen
    }
}

impl<T: Real> InView<T> {
    pub fn new(gaussians: &GaussianRows<T>, camera: &CameraOf<T>, filter: ScreenFilter, grid: TileGrid) -> Self {
        let count = gaussians.len();
        let seen_of_chunk = |chunk: usize| {
            let rows = chunk * CHUNK..count.min((chunk + 1) * CHUNK);
            vectorised(Project { gaussians, camera, filter, grid, rows })
        };
        // collected in the order of the chunks, so that sums do not depend on the number of threads
        let chunks: Vec<Vec<_>> = (0..count.div_ceil(CHUNK)).into_par_iter().map(seen_of_chunk).collect();
        // a counting sort, which keeps the rows of a tile in their order
        let mut next = vec![0; grid.len() + 1];
        for &(tile, ..) in chunks.iter().flatten() {
            next[tile + 1] += 1;
        }
        for tile in 0..grid.len() {
            next[tile + 1] += next[tile];
        }
        let mut order: Vec<(u32, u32)> = vec![(0, 0); next[grid.len()]];
        for (chunk, seen) in chunks.iter().enumerate() {
            for (i, &(tile, ..)) in seen.iter().enumerate() {
                order[next[tile]] = (chunk as u32, i as u32);
                next[tile] += 1;
            }
        }
        let of = |&(chunk, i): &(u32, u32)| &chunks[chunk as usize][i as usize];
        Self {
            rows: order.par_iter().map(|at| of(at).1).collect(),
            splats: order.par_iter().map(|at| of(at).2).collect(),
            rects: order.par_iter().map(|at| of(at).3).collect(),
        }
    }

    /// The place of each of `count` Gaussians in this order, or [`UNSEEN`].
    pub fn places(&self, count: usize) -> Vec<u32> {
        let mut places = vec![UNSEEN; count];
        for (place, &row) in self.rows.iter().enumerate() {
            places[row as usize] = place as u32;
        }
        places
    }
}
