//! How much work the tile lists of a view are: their lengths, how many pairs of a pixel and a primitive the kernels of a
//! GPU evaluate because of them, and how many of these lie in a footprint. Counted on the CPU, in f32, from the same footprints as the lists of GPUs.

use std::ops::Add;

use pulp::Scalar;
use rayon::prelude::*;
use serde::Serialize;

use crate::backend::lanes::Lanes;
use crate::camera::Camera;
use crate::footprint::CUTOFF;
use crate::footprint::gaussian::cpu as splat;
use crate::footprint::gaussian::cpu::Splat;
use crate::footprint::gaussian::cpu::student::Student;
use crate::footprint::rays::rays;
use crate::footprint::surfel::cpu as disc;
use crate::footprint::surfel::cpu::{Disc, MIN_FACING, Plane};
use crate::math::{CameraOf, row};
use crate::ops::peel::PeelOptions;
use crate::scene::{Footprint, GaussianData, ScreenFilter, SurfelData};
use crate::tiles::binning::cpu::{TileLists, bin};
use crate::tiles::{PixelRect, REGION_HEIGHT, REGION_WIDTH, TILE, TileGrid};

/// The tile lists of one kind of primitives in one view.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct TileWork {
    /// Tiles of 16 × 16 px, each with a list.
    pub tiles: usize,
    /// Entries of all lists.
    pub entries: usize,
    /// Entries of the longest list.
    pub longest: usize,
    /// Pairs of a pixel and a primitive that a kernel of a GPU asks about on its way forward. For a surfel these are the
    /// 256 pixels of the tile for each entry; for a Gaussian the 32 pixels of each region of 8 × 4 px of the tile that its
    /// ellipse touches, and in which some pixel sees as far as its depth. A kernel that stops early asks about fewer.
    pub evaluated_pairs: u64,
    /// Pairs whose pixel lies in the image and in the footprint of the primitive.
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
    count(grid, &bin(&rects, grid, |_, _, _| true), &rects, [TILE; 2], |_, _| true, is_inside)
}

/// The lists that `gaussians`, drawn with `filter`, are splatted or blended from: a Gaussian is in those of all tiles that
/// its ellipse touches, unless it lies at or behind `ends`, [H, W], the depth behind which a pixel sees nothing, at every
/// pixel of the tile, world units. The pixels of a region of the tile are asked about it together, by the same rule.
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
            degrees_of_freedom: gaussians.degrees_of_freedom.as_ref().map_or(f32::INFINITY, |degrees| degrees[i]),
        };
        if gaussians.degrees_of_freedom.is_some() {
            let student = Student::new(&view, &parameters, [0.0; 3]);
            let rect = student.as_ref().map_or(PixelRect::EMPTY, |student| student.reach(width, height));
            return ((student.as_ref().map(|student| student.ellipse), student), rect);
        }
        let splat = Splat::new(&view, &parameters, [0.0; 3], filter);
        let rect = splat.as_ref().map_or(PixelRect::EMPTY, |splat| splat.reach(width, height));
        ((splat, None), rect)
    };
    type Seen = (Option<Splat<f32>>, Option<Student<f32>>);
    let (seen, rects): (Vec<Seen>, Vec<PixelRect>) = (0..gaussians.len()).into_par_iter().map(seen).unzip();
    let (splats, students): (Vec<_>, Vec<_>) = seen.into_iter().unzip();
    let of_tiles = Ends::new(ends, grid, [TILE; 2]);
    let of_regions = Ends::new(ends, grid, REGION);
    let reaches = |i: usize, first: [usize; 2], ends: &Ends| {
        splats[i].as_ref().is_some_and(|splat| splat.reaches(first, ends.size) && splat.depth < ends.at(first))
    };
    let is_listed = |i: usize, column: usize, row: usize| reaches(i, [column * TILE, row * TILE], &of_tiles);
    let is_asked = |i: usize, first: [usize; 2]| reaches(i, first, &of_regions);
    let is_inside = |i: usize, x: f32, y: f32| {
        splats[i].as_ref().is_some_and(|splat| {
            let (dx, dy) = (x - splat.mean[0], y - splat.mean[1]);
            if let Some(student) = &students[i] {
                return student.weights(Lanes::splat(Scalar::new(), dx), dy).0.any();
            }
            let [u, v] = splat.in_deviations(dx, dy);
            splat.weight(u, v) > 0.0
        })
    };
    count(grid, &bin(&rects, grid, is_listed), &rects, REGION, is_asked, is_inside)
}

/// Columns and rows of a region, px.
const REGION: [usize; 2] = [REGION_WIDTH, REGION_HEIGHT];

/// The depths at and behind which no pixel of a part of the image sees anything, for all parts of one size.
struct Ends {
    /// Columns and rows of a part, px.
    size: [usize; 2],
    /// Parts in a row.
    columns: usize,
    /// −∞ beside the image.
    depths: Vec<f32>,
}

impl Ends {
    /// From those of the pixels, [H, W]; pixels that all see to infinity without them.
    fn new(of_pixels: Option<&[f32]>, grid: TileGrid, size: [usize; 2]) -> Self {
        let [width, height] = size;
        let [columns, rows] = [grid.columns * TILE / width, grid.rows * TILE / height];
        if let Some(of_pixels) = of_pixels {
            assert_eq!(of_pixels.len(), grid.width * grid.height, "a depth for every pixel");
        }
        let mut depths = vec![f32::NEG_INFINITY; columns * rows];
        for pixel in 0..grid.width * grid.height {
            let (x, y) = (pixel % grid.width, pixel / grid.width);
            let part = &mut depths[y / height * columns + x / width];
            *part = part.max(of_pixels.map_or(f32::INFINITY, |of_pixels| of_pixels[pixel]));
        }
        Self { size, columns, depths }
    }

    /// Value of the part that starts at a pixel's column and row.
    fn at(&self, first: [usize; 2]) -> f32 {
        self.depths[first[1] / self.size[1] * self.columns + first[0] / self.size[0]]
    }
}

/// `is_asked(primitive, first)` tells whether the pixels of the part of a tile from `first` on, of the `size` of all parts,
/// are asked about a primitive of its list. `is_inside(primitive, x, y)` tells whether the point (x, y) px lies in its
/// footprint, and is false outside its rectangle.
fn count(
    grid: TileGrid,
    lists: &TileLists,
    rects: &[PixelRect],
    size: [usize; 2],
    is_asked: impl Fn(usize, [usize; 2]) -> bool + Sync,
    is_inside: impl Fn(usize, f32, f32) -> bool + Sync,
) -> TileWork {
    let [width, height] = size;
    let pixels_inside = |id: usize, [x, y]: [usize; 2]| {
        let PixelRect { x0, x1, y0, y1 } = rects[id];
        let columns = x.max(x0 as usize)..(x + width).min(x1 as usize);
        let rows = y.max(y0 as usize)..(y + height).min(y1 as usize);
        let is_inside = |x: usize, y: usize| is_inside(id, x as f32 + 0.5, y as f32 + 0.5);
        rows.map(|y| columns.clone().filter(|&x| is_inside(x, y)).count() as u64).sum::<u64>()
    };
    let of_tile = |tile: usize| {
        let (list, (left, top)) = (lists.of(tile), grid.origin(tile));
        let mut work = TileWork { tiles: 1, entries: list.len(), longest: list.len(), ..TileWork::default() };
        for id in list.iter().map(|&id| id as usize) {
            for y in (top..top + TILE).step_by(height) {
                for first in (left..left + TILE).step_by(width).map(|x| [x, y]) {
                    if is_asked(id, first) {
                        work.evaluated_pairs += (width * height) as u64;
                        work.inside_pairs += pixels_inside(id, first);
                    }
                }
            }
        }
        work
    };
    (0..grid.len()).into_par_iter().map(of_tile).reduce(TileWork::default, TileWork::add)
}

#[cfg(all(test, any(feature = "ndarray", feature = "flex")))]
mod tests;
