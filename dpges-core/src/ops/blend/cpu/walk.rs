//! Primitives sorted by depth, and the walk through a tile from front to back in that order.

use rayon::prelude::*;

use super::normal::normal;
use super::projected::{CameraPair, Projected};
use crate::backend::real::Real;
use crate::backend::simd::LANES;
use crate::footprint::gaussian::cpu::along_ray::AlongRay;
use crate::footprint::gaussian::tensors::GaussianRows;
use crate::math::V3;
use crate::ops::blend::BlendOptions;
use crate::scene::BlendOrder;
use crate::tiles::binning::cpu::{TileLists, bin};
use crate::tiles::for_each_group;
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
        let lists = bin(&rects, grid, |i, tx, ty| footprints[i].touches(tx, ty));
        Self { rows, footprints, normals, along, rects, grid, lists }
    }
}

pub struct Thresholds<T> {
    pub max_alpha: T,
    pub min_transmittance: T,
    /// 1 if a pixel ends behind the fragment that takes T below that, 0 if before it.
    pub ends_behind: T,
}

impl<T: Real> Thresholds<T> {
    pub fn new(options: &BlendOptions) -> Self {
        Self {
            max_alpha: T::of(options.max_alpha),
            min_transmittance: T::of(options.min_transmittance),
            ends_behind: if options.form.ends_behind() { T::one() } else { T::zero() },
        }
    }
}

/// State of the pixels of a tile.
pub struct Progress<T> {
    /// T
    pub through: [T; TILE_PIXELS],
    /// 1 until a pixel has ended, then 0; 0 outside the image.
    open: [T; TILE_PIXELS],
    /// Entry of the list before which a pixel ends; 0 outside the image. A whole number of type `T`, so that loops
    /// over it vectorise.
    pub end: [T; TILE_PIXELS],
}

impl<T: Real> Progress<T> {
    /// No pixel ends before the last of `entries`.
    #[inline(always)]
    fn new(entries: usize, origin: (usize, usize), grid: TileGrid) -> Self {
        let zero = [T::zero(); TILE_PIXELS];
        let mut progress = Self { through: [T::one(); TILE_PIXELS], open: zero, end: zero };
        let (columns, rows) = (TILE.min(grid.width - origin.0), TILE.min(grid.height - origin.1));
        for line in 0..rows {
            progress.end[line * TILE..][..columns].fill(T::of(entries as f64));
            progress.open[line * TILE..][..columns].fill(T::one());
        }
        progress
    }

    /// All pixels have ended, with T `through`.
    pub fn ended(through: [T; TILE_PIXELS]) -> Self {
        let zero = [T::zero(); TILE_PIXELS];
        Self { through, open: zero, end: zero }
    }

    /// Entry before which all pixels have ended.
    #[inline(always)]
    pub fn last_end(&self) -> usize {
        self.end.iter().fold(T::zero(), |last, &end| last.max(end)).as_f64() as usize
    }
}

#[inline(always)]
pub fn group<V>(values: &mut [V], start: usize) -> &mut [V; LANES] {
    (&mut values[start..start + LANES]).try_into().expect("one group")
}

/// Fragments of a group of lanes. They are on the heap because the compiler splits local arrays into scalars.
pub struct Fragments<T> {
    /// α before it is capped.
    weight: [T; LANES],
    /// z
    pub depth: [T; LANES],
    /// αT, 0 where nothing is blended.
    pub covered: [T; LANES],
    /// T behind it.
    pub through: [T; LANES],
}

impl<T: Real> Fragments<T> {
    pub fn nothing() -> Self {
        let (zero, one) = ([T::zero(); LANES], [T::one(); LANES]);
        Self { weight: zero, depth: one, covered: zero, through: one }
    }

    /// Sets the only fragment.
    pub fn set(&mut self, lane: usize, covered: T, through: T, depth: T) {
        (self.covered[lane], self.through[lane], self.depth[lane]) = (covered, through, depth);
    }

    pub fn clear(&mut self, lane: usize) {
        self.set(lane, T::zero(), T::one(), T::one());
    }
}

/// Goes through a tile front to back. Calls `visit(position, start, fragments)` for every group of lanes in which a
/// primitive is blended.
#[inline(always)]
pub fn walk_tile<T: Real, F: Projected<T>>(
    sorted: &Sorted<T, F>,
    tile: usize,
    thresholds: &Thresholds<T>,
    mut visit: impl FnMut(usize, usize, &Fragments<T>),
) -> Progress<T> {
    let (list, origin) = (sorted.lists.of(tile), sorted.grid.origin(tile));
    let mut progress = Progress::<T>::new(list.len(), origin, sorted.grid);
    let none = [T::zero(); LANES];
    let mut fragments = vec![Fragments { weight: none, depth: none, covered: none, through: none }];
    for (entry, &id) in list.iter().enumerate() {
        if entry.is_multiple_of(LOOK_EVERY) && progress.last_end() <= entry {
            break;
        }
        let (entry, id) = (T::of(entry as f64), id as usize);
        let footprint = &sorted.footprints[id];
        for_each_group(
            footprint.anchor(),
            &sorted.rects[id],
            origin,
            #[inline(always)]
            |start, dx, dy| {
                let [Fragments { weight, depth, covered, through: behind }] = fragments.as_mut_slice() else {
                    unreachable!("one group");
                };
                let open = group(&mut progress.open, start);
                footprint.fragments(&dx, dy, weight, depth);
                for lane in 0..LANES {
                    weight[lane] = weight[lane] * open[lane];
                }
                if is_nothing(weight) {
                    return;
                }
                let through = group(&mut progress.through, start);
                let end = group(&mut progress.end, start);
                for lane in 0..LANES {
                    let alpha = weight[lane].min(thresholds.max_alpha).max(-thresholds.max_alpha);
                    covered[lane] = alpha * through[lane];
                    behind[lane] = through[lane] * (T::one() - alpha);
                }
                for lane in 0..LANES {
                    let goes_on = if behind[lane] >= thresholds.min_transmittance { T::one() } else { T::zero() };
                    let stays = open[lane] * goes_on;
                    let ends = open[lane] - stays;
                    end[lane] = end[lane] + ends * (entry + thresholds.ends_behind - end[lane]);
                    let blended = stays + thresholds.ends_behind * ends;
                    covered[lane] = covered[lane] * blended;
                    behind[lane] = blended * behind[lane] + (T::one() - blended) * through[lane];
                    open[lane] = stays;
                }
                through.copy_from_slice(behind);
                visit(id, start, &fragments[0]);
            },
        );
    }
    progress
}

/// Whether weights are all 0.
#[inline(always)]
pub fn is_nothing<T: Real>(values: &[T; LANES]) -> bool {
    values.iter().map(|value| value.abs()).sum::<T>() == T::zero()
}

/// Values of the pixels of a tile for an entry of its list: αT, gradient of the exponent, gradient of z.
pub type Said<T> = [[T; TILE_PIXELS]; 3];
