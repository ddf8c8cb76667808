//! Primitives sorted by depth, and the walk through a tile from front to back in that order.

use pulp::{Scalar, Simd};
use rayon::prelude::*;

use super::normal::normal;
use super::projected::{CameraPair, Drawn, Projected};
use crate::backend::lanes::{Lanes, Mask};
use crate::backend::real::Real;
use crate::footprint::gaussian::cpu::along_ray::AlongRay;
use crate::footprint::gaussian::tensors::GaussianRows;
use crate::math::{CameraOf, V3};
use crate::ops::blend::BlendOptions;
use crate::scene::BlendOrder;
use crate::tiles::binning::cpu::{TileLists, bin};
use crate::tiles::for_each_lanes;
use crate::tiles::{PixelRect, TILE, TILE_PIXELS, TileGrid};

/// Whether all pixels of a tile have ended is looked up after this many primitives.
const LOOK_EVERY: usize = 16;

/// Visible primitives front to back.
pub struct Sorted<T, F> {
    /// Row of each in the parameters.
    pub rows: Vec<usize>,
    pub footprints: Vec<F>,
    /// Facing the camera, camera axes; empty without maps.
    pub normals: Vec<V3<T>>,
    /// Empty in the order of centres.
    pub along: Vec<AlongRay<T>>,
    pub rects: Vec<PixelRect>,
    pub grid: TileGrid,
    /// Positions in this order; ascending, thus front to back.
    pub lists: TileLists,
}

impl<T: Real, F: Projected<T>> Sorted<T, F> {
    pub fn new(gaussians: &GaussianRows<T>, view: &CameraPair<T>, options: &BlendOptions) -> Self {
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
        let along = match options.order {
            BlendOrder::Centres | BlendOrder::Whitened(_) => Vec::new(),
            BlendOrder::Rays => {
                let along = |(row, footprint): (&usize, &F)| {
                    footprint.along_ray(&view.camera, &gaussians.parameters(*row)).expect("only ellipsoids")
                };
                rows.par_iter().zip(&footprints).map(along).collect()
            }
        };
        let rects: Vec<PixelRect> = footprints.par_iter().map(|footprint| footprint.reach(grid)).collect();
        // ids are places in the sorted order, so that ascending lists run front to back
        let lists = bin(&rects, grid, |i, tx, ty| footprints[i].touches(tx, ty));
        Self { rows, footprints, normals, along, rects, grid, lists }
    }
}

/// A tile of a view, and how its pixels are blended.
pub struct Tile<'a, T, F> {
    pub sorted: &'a Sorted<T, F>,
    pub camera: &'a CameraOf<T>,
    pub number: usize,
    pub thresholds: &'a Thresholds<T>,
    /// Slope of the m of distortion.
    pub slope: T,
    pub order: BlendOrder,
}

impl<'a, T, F> Tile<'a, T, F> {
    /// Positions of its primitives among the sorted ones.
    #[inline(always)]
    pub fn list(&self) -> &'a [u32] {
        self.sorted.lists.of(self.number)
    }

    /// Its first pixel.
    #[inline(always)]
    pub fn origin(&self) -> (usize, usize) {
        self.sorted.grid.origin(self.number)
    }
}

pub struct Thresholds<T> {
    pub max_alpha: T,
    pub min_transmittance: T,
    /// Whether a pixel ends behind the fragment that takes T below that, or before it.
    pub ends_behind: bool,
}

impl<T: Real> Thresholds<T> {
    pub fn new(options: &BlendOptions) -> Self {
        Self {
            max_alpha: T::of(options.max_alpha),
            min_transmittance: T::of(options.min_transmittance),
            ends_behind: options.form.ends_behind(),
        }
    }
}

/// A weight as α, capped on both sides.
#[inline(always)]
pub fn capped<T: Real, S: Simd>(weight: Lanes<T, S>, max_alpha: T) -> Lanes<T, S> {
    let all = |value: T| Lanes::splat(weight.simd(), value);
    // on both sides: negative α takes colour away (SSS); below 1 in size, since the backward pass divides by 1 − α
    weight.min(all(max_alpha)).max(all(-max_alpha))
}

/// State of the pixels of a tile.
pub struct Progress<T> {
    /// T
    pub through: [T; TILE_PIXELS],
    /// Entry of the list before which a pixel ends; 0 outside the image. A whole number of type `T`, which vectors compare.
    pub end: [T; TILE_PIXELS],
}

impl<T: Real> Progress<T> {
    /// No pixel ends before the last of `entries`.
    #[inline(always)]
    fn new(entries: usize, origin: (usize, usize), grid: TileGrid) -> Self {
        let mut progress = Self::ended([T::one(); TILE_PIXELS]);
        let (columns, rows) = (TILE.min(grid.width - origin.0), TILE.min(grid.height - origin.1));
        for line in 0..rows {
            progress.end[line * TILE..][..columns].fill(T::of(entries as f64));
        }
        progress
    }

    /// All pixels have ended, with T `through`.
    pub fn ended(through: [T; TILE_PIXELS]) -> Self {
        Self { through, end: [T::zero(); TILE_PIXELS] }
    }

    /// Entry before which all pixels have ended.
    #[inline(always)]
    pub fn last_end<S: Simd>(&self, simd: S) -> usize {
        let ends = self.end.chunks_exact(T::lane_count::<S>());
        ends.fold(Lanes::zero(simd), |last, ends| last.max(Lanes::load(simd, ends))).largest().as_f64() as usize
    }
}

/// The blended fragments of a primitive at the pixels of a vector.
pub struct Fragments<T: Real, S: Simd> {
    /// Pixels in which the primitive is blended.
    pub blended: Mask<T, S>,
    /// z
    pub depth: Lanes<T, S>,
    /// αT, 0 where nothing is blended.
    pub covered: Lanes<T, S>,
    /// T behind it.
    pub through: Lanes<T, S>,
}

impl<T: Real> Fragments<T, Scalar> {
    /// A fragment of one pixel.
    pub fn single(covered: T, through: T, depth: T) -> Self {
        let one = |value: T| Lanes::splat(Scalar::new(), value);
        let (covered, through, depth) = (one(covered), one(through), one(depth));
        Self { blended: one(T::zero()).below(covered), depth, covered, through }
    }
}

/// Goes through a tile front to back. Calls `visit(id, start, fragments)` for every vector of pixels in which a primitive is
/// drawn.
#[inline(always)]
pub fn walk_tile<T: Real, F: Projected<T>, S: Simd>(
    simd: S,
    tile: &Tile<T, F>,
    mut visit: impl FnMut(usize, usize, &Fragments<T, S>),
) -> Progress<T> {
    let (list, origin, sorted, thresholds) = (tile.list(), tile.origin(), tile.sorted, tile.thresholds);
    let mut progress = Progress::<T>::new(list.len(), origin, sorted.grid);
    let all = |value: T| Lanes::splat(simd, value);
    let (one, least) = (all(T::one()), all(thresholds.min_transmittance));
    for (entry, &id) in list.iter().enumerate() {
        // a look reads all pixels of the tile
        if entry.is_multiple_of(LOOK_EVERY) && progress.last_end(simd) <= entry {
            break;
        }
        let id = id as usize;
        let footprint = &sorted.footprints[id];
        let entry = T::of(entry as f64);
        // 3DGS ends before the fragment that would take T below the least, HTGS behind it
        let end_here = all(if thresholds.ends_behind { entry + T::one() } else { entry });
        for_each_lanes(
            simd,
            footprint.anchor(),
            &sorted.rects[id],
            origin,
            #[inline(always)]
            |start, dx, dy| {
                let Some(Drawn { drawn, weight, depth }) = footprint.draw(dx, dy) else { return };
                let end = Lanes::load(simd, &progress.end[start..]);
                let drawn = drawn & all(entry).below(end);
                if !drawn.any() {
                    return;
                }
                let through = Lanes::load(simd, &progress.through[start..]);
                // what is not drawn has any finite weight: masks below keep it out of sums
                let alpha = capped(weight, thresholds.max_alpha);
                let behind = through * (one - alpha);
                let goes_on = behind.at_least(least);
                Lanes::select(drawn, Lanes::select(goes_on, end, end_here), end).store(&mut progress.end[start..]);
                let blended = if thresholds.ends_behind { drawn } else { drawn & goes_on };
                let fragments = Fragments {
                    blended,
                    depth,
                    covered: (alpha * through).only(blended),
                    through: Lanes::select(blended, behind, through),
                };
                fragments.through.store(&mut progress.through[start..]);
                visit(id, start, &fragments);
            },
        );
    }
    progress
}

/// Values of the pixels of a tile for an entry of its list: αT, gradient of the exponent, gradient of z.
pub type Said<T> = [[T; TILE_PIXELS]; 3];
