//! The Gaussians that a camera sees, neighbours in the image beside one another.

use rayon::prelude::*;

use super::Splat;
use crate::backend::real::Real;
use crate::backend::simd::vectorised;
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

impl<T: Real> InView<T> {
    pub fn new(gaussians: &GaussianRows<T>, camera: &CameraOf<T>, filter: ScreenFilter, grid: TileGrid) -> Self {
        let count = gaussians.len();
        let seen_of_chunk = |chunk: usize| {
            let seen = |row: usize| {
                let splat = gaussians.splat(camera, row, filter)?;
                let rect = splat.reach(grid.width, grid.height);
                let [column, _, line, _] = rect.tiles();
                (!rect.is_empty()).then_some((line * grid.columns + column, row as u32, splat, rect))
            };
            let rows = chunk * CHUNK..count.min((chunk + 1) * CHUNK);
            vectorised(
                #[inline(always)]
                || rows.filter_map(seen).collect::<Vec<_>>(),
            )
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
