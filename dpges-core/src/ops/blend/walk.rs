//! Primitives sorted by depth, and the way through a tile front to back.

use rayon::prelude::*;

use super::BlendOptions;
use super::footprint::{Projected, View};
use super::normal::normal;
use crate::math::V3;
use crate::ops::binning::{LANES, PixelRect, TILE, TILE_PIXELS, TileGrid, TileLists, bin};
use crate::ops::splat::{GaussianRows, for_each_group};
use crate::real::Real;

/// Whether all pixels of a tile have ended is looked up after this many primitives.
const LOOK_EVERY: usize = 16;

/// Visible primitives front to back.
pub struct Sorted<T, F> {
    /// Row of each in the parameters.
    pub rows: Vec<usize>,
    pub footprints: Vec<F>,
    /// Facing the camera, camera axes; empty without maps.
    pub normals: Vec<V3<T>>,
    pub rects: Vec<PixelRect>,
    pub grid: TileGrid,
    /// Positions in this order; ascending, thus front to back.
    pub lists: TileLists,
}

impl<T: Real, F: Projected<T>> Sorted<T, F> {
    pub fn new(gaussians: &GaussianRows<T>, view: &View<T>, options: &BlendOptions) -> Self {
        let grid = TileGrid::new(view.camera.width, view.camera.height);
        let project = |row: usize| F::new(view, &gaussians.parameters(row), gaussians.colour(row));
        let mut visible: Vec<(usize, F)> = (0..gaussians.len())
            .into_par_iter()
            .filter_map(|row| project(row).map(|footprint| (row, footprint)))
            .collect();
        // stable: ties stay in the order of their rows
        visible.par_sort_by(|(_, a), (_, b)| a.centre_depth().as_f64().total_cmp(&b.centre_depth().as_f64()));
        let (rows, footprints): (Vec<usize>, Vec<F>) = visible.into_iter().unzip();
        let normal_of = |row: &usize| {
            let parameters = gaussians.parameters(*row);
            normal(&view.camera, &parameters, F::normal_axis(&parameters))
        };
        let normals = if options.maps { rows.par_iter().map(normal_of).collect() } else { Vec::new() };
        let rects: Vec<PixelRect> = footprints.par_iter().map(|footprint| footprint.reach(grid)).collect();
        let lists = bin(&rects, grid, |i, tx, ty| footprints[i].touches(tx, ty));
        Self { rows, footprints, normals, rects, grid, lists }
    }
}

pub struct Thresholds<T> {
    pub max_alpha: T,
    pub min_transmittance: T,
}

impl<T: Real> Thresholds<T> {
    pub fn new(options: &BlendOptions) -> Self {
        Self { max_alpha: T::of(options.max_alpha), min_transmittance: T::of(options.min_transmittance) }
    }
}

/// How far the pixels of a tile got.
pub struct Progress<T> {
    /// T
    pub through: [T; TILE_PIXELS],
    /// Entry of the tile's list before which a pixel ends; 0 outside the image.
    pub end: [u32; TILE_PIXELS],
}

impl<T: Real> Progress<T> {
    /// No pixel ends before the last of `entries`.
    #[inline(always)]
    fn new(entries: usize, origin: (usize, usize), grid: TileGrid) -> Self {
        let mut progress = Self { through: [T::one(); TILE_PIXELS], end: [0; TILE_PIXELS] };
        let (columns, rows) = (TILE.min(grid.width - origin.0), TILE.min(grid.height - origin.1));
        for line in progress.end.chunks_mut(TILE).take(rows) {
            line[..columns].fill(entries as u32);
        }
        progress
    }

    /// Entry before which all pixels have ended.
    #[inline(always)]
    pub fn last_end(&self) -> usize {
        self.end.iter().fold(0, |last: u32, &end| last.max(end)) as usize
    }
}

#[inline(always)]
pub fn group<V>(values: &mut [V], start: usize) -> &mut [V; LANES] {
    (&mut values[start..start + LANES]).try_into().expect("one group")
}

/// Goes through a tile front to back. Calls `visit(position, start, covered, through, depth)` for every
/// group of lanes that a primitive can reach: its αT, 0 where it is not blended, T behind it, and its z.
#[inline(always)]
pub fn walk_tile<T: Real, F: Projected<T>>(
    sorted: &Sorted<T, F>,
    tile: usize,
    thresholds: &Thresholds<T>,
    mut visit: impl FnMut(usize, usize, [T; LANES], [T; LANES], [T; LANES]),
) -> Progress<T> {
    let (list, origin) = (sorted.lists.of(tile), sorted.grid.origin(tile));
    let mut progress = Progress::<T>::new(list.len(), origin, sorted.grid);
    for (entry, &id) in list.iter().enumerate() {
        if entry.is_multiple_of(LOOK_EVERY) && progress.last_end() <= entry {
            break;
        }
        let (entry, id) = (entry as u32, id as usize);
        let footprint = &sorted.footprints[id];
        for_each_group(
            footprint.anchor(),
            &sorted.rects[id],
            origin,
            #[inline(always)]
            |start, dx, dy| {
                let through = group(&mut progress.through, start);
                let end = group(&mut progress.end, start);
                let mut covered = [T::zero(); LANES];
                let mut depth = [T::zero(); LANES];
                for lane in 0..LANES {
                    let (weight, z) = footprint.fragment(dx[lane], dy);
                    let alpha = weight.min(thresholds.max_alpha);
                    let behind = through[lane] * (T::one() - alpha);
                    let open = entry < end[lane];
                    let blended = open & (behind >= thresholds.min_transmittance);
                    end[lane] = if open & !blended { entry } else { end[lane] };
                    covered[lane] = if blended { alpha * through[lane] } else { T::zero() };
                    through[lane] = if blended { behind } else { through[lane] };
                    depth[lane] = z;
                }
                visit(id, start, covered, *through, depth);
            },
        );
    }
    progress
}
