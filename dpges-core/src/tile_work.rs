//! How much work the tile lists of a view are: their lengths, and how many of the pairs of a pixel and a primitive that
//! they make lie in a footprint. Counted on the CPU, in f32, from the same footprints as the lists of GPUs.

use std::ops::Add;

use rayon::prelude::*;
use serde::Serialize;

use crate::binning::cpu::{TileLists, bin};
use crate::camera::Camera;
use crate::footprint::CUTOFF;
use crate::footprint::disc::{self, Disc, MIN_FACING, Plane};
use crate::footprint::rays::rays;
use crate::footprint::splat::{self, Splat};
use crate::math::{CameraOf, row};
use crate::ops::peel::PeelOptions;
use crate::scene::{Footprint, GaussianData, ScreenFilter, SurfelData};
use crate::tiles::{PixelRect, TILE, TILE_PIXELS, TileGrid};

/// The tile lists of one kind of primitives in one view.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct TileWork {
    /// Tiles of 16 × 16 px, each with a list.
    pub tiles: usize,
    /// Entries of all lists.
    pub entries: usize,
    /// Entries of the longest list.
    pub longest: usize,
    /// Pairs of a pixel and a primitive if every pixel of a tile is asked about every entry of its list: 256 an entry. A
    /// kernel that stops early asks about fewer.
    pub evaluated_pairs: u64,
    /// Pairs of a pixel of the image and a primitive of which it lies in the footprint.
    pub inside_pairs: u64,
}

impl TileWork {
    /// Share of the evaluated pairs that lie in a footprint; `None` without any pairs.
    pub fn inside_share(&self) -> Option<f64> {
        (self.evaluated_pairs > 0).then(|| self.inside_pairs as f64 / self.evaluated_pairs as f64)
    }
}

impl Add for TileWork {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        Self {
            tiles: self.tiles + other.tiles,
            entries: self.entries + other.entries,
            longest: self.longest.max(other.longest),
            evaluated_pairs: self.evaluated_pairs + other.evaluated_pairs,
            inside_pairs: self.inside_pairs + other.inside_pairs,
        }
    }
}

/// The lists that `surfels` are peeled from: a surfel is in those of all tiles that the rectangle around its footprint
/// overlaps.
pub fn surfel_work(surfels: &SurfelData, camera: &Camera, options: &PeelOptions) -> TileWork {
    let view = CameraOf::<f64>::new(camera);
    let radius = options.footprint.radius(options.modulation);
    let seen = |i: usize| {
        let surfel = disc::Parameters {
            position: row::<f32, 3>(&surfels.positions, i).map(f64::from),
            quaternion: row::<f32, 4>(&surfels.quaternions, i).map(f64::from),
            log_scales: row::<f32, 2>(&surfels.log_scales, i).map(f64::from),
        };
        let disc = Disc::new(&view, &surfel);
        let rect = radius.map_or(PixelRect::EMPTY, |radius| disc.reach(&view, radius));
        (disc.plane.cast::<f32>(), rect)
    };
    let (planes, rects): (Vec<Plane<f32>>, Vec<PixelRect>) = (0..surfels.len()).into_par_iter().map(seen).unzip();
    let grid = TileGrid::new(camera.width, camera.height);
    let (near, modulation) = (camera.near as f32, options.modulation as f32);
    let rays = rays(camera);
    let is_inside = |i: usize, x: f32, y: f32| {
        let hit = match &rays {
            None => planes[i].hit(x, y),
            Some(rays) => planes[i].hit_by(rays[y as usize * camera.width + x as usize].map(|v| v as f32)),
        };
        let measure = match options.footprint {
            Footprint::Kernel => hit.kernel,
            Footprint::Opacity => (modulation * hit.kernel).min(1.0),
        };
        hit.facing.abs() > MIN_FACING as f32 && hit.depth > near && measure >= CUTOFF as f32
    };
    count(grid, &bin(&rects, grid, |_, _, _| true), &rects, is_inside)
}

/// The lists that `gaussians`, drawn with `filter`, are splatted or blended from: a Gaussian is in those of all tiles that
/// its ellipse touches, unless it lies at or behind `ends`, [H, W], the depth behind which a pixel sees nothing, at every
/// pixel of the tile, world units.
///
/// # Panics
/// If `ends` is not as large as the picture of `camera`.
pub fn gaussian_work(
    gaussians: &GaussianData,
    camera: &Camera,
    filter: ScreenFilter,
    ends: Option<&[f32]>,
) -> TileWork {
    let view = CameraOf::<f32>::new(camera);
    let (width, height) = (camera.width, camera.height);
    let grid = TileGrid::new(width, height);
    let seen = |i: usize| {
        let parameters = splat::Parameters {
            position: row(&gaussians.positions, i),
            quaternion: row(&gaussians.quaternions, i),
            log_scales: row(&gaussians.log_scales, i),
            opacity: gaussians.opacities[i],
        };
        let splat = Splat::new(&view, &parameters, [0.0; 3], filter);
        let rect = splat.as_ref().map_or(PixelRect::EMPTY, |splat| splat.reach(width, height));
        (splat, rect)
    };
    let (splats, rects): (Vec<Option<Splat<f32>>>, Vec<PixelRect>) =
        (0..gaussians.len()).into_par_iter().map(seen).unzip();
    let ends = ends.map(|ends| furthest(ends, grid));
    let is_listed = |i: usize, column: usize, row: usize| {
        splats[i].as_ref().is_some_and(|splat| {
            let end = ends.as_ref().map_or(f32::INFINITY, |ends| ends[row * grid.columns + column]);
            splat.touches(column, row) && splat.depth < end
        })
    };
    let is_inside = |i: usize, x: f32, y: f32| {
        splats[i].as_ref().is_some_and(|splat| {
            let [u, v] = splat.in_deviations(x - splat.mean[0], y - splat.mean[1]);
            splat.weight(u, v) > 0.0
        })
    };
    count(grid, &bin(&rects, grid, is_listed), &rects, is_inside)
}

/// `[tiles]` the largest of the values [H, W] in each tile.
fn furthest(values: &[f32], grid: TileGrid) -> Vec<f32> {
    assert_eq!(values.len(), grid.width * grid.height, "a depth for every pixel");
    let mut furthest = vec![f32::NEG_INFINITY; grid.len()];
    for (pixel, &value) in values.iter().enumerate() {
        let (column, row) = (pixel % grid.width / TILE, pixel / grid.width / TILE);
        let tile = &mut furthest[row * grid.columns + column];
        *tile = tile.max(value);
    }
    furthest
}

/// `is_inside(primitive, x, y)` tells whether the point (x, y) px lies in its footprint, and is false outside its rectangle.
fn count(
    grid: TileGrid,
    lists: &TileLists,
    rects: &[PixelRect],
    is_inside: impl Fn(usize, f32, f32) -> bool + Sync,
) -> TileWork {
    let of_tile = |tile: usize| {
        let (list, origin) = (lists.of(tile), grid.origin(tile));
        let pixels_inside = |&id: &u32| {
            let [x0, x1, y0, y1] = rects[id as usize].within_tile(origin);
            let pixels = (y0..y1).flat_map(|y| (x0..x1).map(move |x| (x, y)));
            let centre = |(x, y): (usize, usize)| ((origin.0 + x) as f32 + 0.5, (origin.1 + y) as f32 + 0.5);
            pixels.map(centre).filter(|&(x, y)| is_inside(id as usize, x, y)).count() as u64
        };
        TileWork {
            tiles: 1,
            entries: list.len(),
            longest: list.len(),
            evaluated_pairs: (list.len() * TILE_PIXELS) as u64,
            inside_pairs: list.iter().map(pixels_inside).sum(),
        }
    };
    (0..grid.len()).into_par_iter().map(of_tile).reduce(TileWork::default, TileWork::add)
}

#[cfg(all(test, any(feature = "ndarray", feature = "flex")))]
mod tests;
