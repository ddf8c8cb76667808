//! Initialisation from the visual hull of pictures with alpha (Laurentini): the surface of what lies inside every
//! silhouette, coloured by the views that face it best.

use std::sync::Arc;

use dpges_core::Result;
use dpges_core::camera::Camera;
use glam::{DVec3, IVec3};
use rayon::prelude::*;

use super::placement::OrientedPoints;
use super::region::Region;
use crate::dataset::{Picture, View, pictures};

/// A pixel with more than this alpha shows no background.
const OPAQUE: f32 = 0.9;
/// Number of views that determine a colour.
const VOTERS: usize = 5;
/// Largest distance of a visible point behind the nearest surface, voxels.
const HIDDEN_BEHIND: f64 = 2.5;

/// The views whose photographs have alpha that says what is outside.
#[derive(Debug)]
pub struct Silhouettes<'a>(Vec<&'a View>);

impl<'a> Silhouettes<'a> {
    /// `None` if there are none among `views`.
    pub fn new(views: &'a [View]) -> Option<Self> {
        let views: Vec<&View> = views.iter().filter(|view| view.photograph.has_transparency()).collect();
        (!views.is_empty()).then_some(Self(views))
    }

    fn len(&self) -> usize {
        self.0.len()
    }

    fn pictures(&self) -> impl Iterator<Item = (&'a View, Result<Arc<Picture>>)> {
        pictures(self.0.iter().copied())
    }
}

/// Nearly cubic voxels that fill a region, `sides` of them along each axis.
struct Grid {
    region: Region,
    sides: usize,
}

impl Grid {
    fn step(&self) -> DVec3 {
        self.region.size() / self.sides as f64
    }

    fn len(&self) -> usize {
        self.sides.pow(3)
    }

    fn voxel(&self, index: usize) -> IVec3 {
        let n = self.sides;
        IVec3::new((index % n) as i32, (index / n % n) as i32, (index / (n * n)) as i32)
    }

    fn index(&self, voxel: IVec3) -> Option<usize> {
        let n = self.sides as i32;
        let inside = voxel.min_element() >= 0 && voxel.max_element() < n;
        inside.then(|| (voxel.x + n * (voxel.y + n * voxel.z)) as usize)
    }

    fn centre(&self, voxel: IVec3) -> DVec3 {
        self.region.low + self.step() * (voxel.as_dvec3() + 0.5)
    }
}

/// Share of the views whose silhouettes may miss a voxel of a run's visual hull: masks are not exact.
pub const TOLERANCE: f64 = 0.02;

/// Points on the surface of the visual hull inside `region`, one per boundary voxel. The grid has `resolution` voxels
/// along each side and is fitted to the occupied part of the region. A voxel is occupied if at least half of the views
/// show its centre and at most the share `tolerance` of these show it outside their silhouette. Empty if the
/// silhouettes have no volume in common.
///
/// # Errors
/// [`dpges_core::Error::Io`] if a photograph cannot be read again.
pub fn hull_points(
    silhouettes: &Silhouettes<'_>,
    region: Region,
    resolution: usize,
    tolerance: f64,
) -> Result<OrientedPoints> {
    let coarse = Grid { region, sides: resolution.div_ceil(2) };
    let region = occupied_region(&coarse, &carve(&coarse, silhouettes, tolerance)?).unwrap_or(region);
    let grid = Grid { region, sides: resolution };
    let occupied = carve(&grid, silhouettes, tolerance)?;

    let is_occupied = |voxel: IVec3| grid.index(voxel).is_some_and(|index| occupied[index]);
    let on_surface = |&index: &usize| {
        let voxel = grid.voxel(index);
        occupied[index] && IVec3::AXES.iter().any(|&axis| !is_occupied(voxel + axis) || !is_occupied(voxel - axis))
    };
    let surface: Vec<usize> = (0..grid.len()).into_par_iter().filter(on_surface).collect();
    let points: Vec<DVec3> = surface.iter().map(|&index| grid.centre(grid.voxel(index))).collect();
    let normals: Vec<DVec3> = surface.par_iter().map(|&index| outwards(grid.voxel(index), is_occupied)).collect();
    let colours = colours(silhouettes, &points, &normals, grid.step().max_element())?;
    Ok(OrientedPoints { positions: points.iter().map(|p| p.as_vec3().to_array()).collect(), colours, normals })
}

/// How many views show a voxel, and how many of these show it outside of their silhouettes.
#[derive(Clone, Copy, Default)]
struct Shown {
    seen: u32,
    misses: u32,
}

fn carve(grid: &Grid, silhouettes: &Silhouettes<'_>, tolerance: f64) -> Result<Vec<bool>> {
    let most_misses = tolerance * silhouettes.len() as f64;
    let mut shown = vec![Shown::default(); grid.len()];
    for (view, picture) in silhouettes.pictures() {
        let picture = picture?;
        shown.par_iter_mut().enumerate().for_each(|(index, shown)| {
            if f64::from(shown.misses) > most_misses {
                return;
            }
            if let Some((pixel, _)) = view.camera.pixel(grid.centre(grid.voxel(index))) {
                shown.seen += 1;
                shown.misses += u32::from(picture.is_transparent(pixel));
            }
        });
    }
    let occupied = |Shown { seen, misses }: Shown| {
        seen > 0 && 2 * seen as usize >= silhouettes.len() && f64::from(misses) <= tolerance * f64::from(seen)
    };
    Ok(shown.into_iter().map(occupied).collect())
}

/// The box around the occupied voxels, enlarged by what a coarse grid may miss.
fn occupied_region(grid: &Grid, occupied: &[bool]) -> Option<Region> {
    let corners = (0..grid.len()).filter(|&index| occupied[index]).map(|index| grid.voxel(index));
    let (low, high) = corners.fold(None, |bounds: Option<(IVec3, IVec3)>, voxel| {
        bounds.map_or(Some((voxel, voxel)), |(low, high)| Some((low.min(voxel), high.max(voxel))))
    })?;
    let side = (high - low).as_dvec3() + 1.0;
    let room = grid.step() * 2.0;
    let low = grid.region.low + grid.step() * low.as_dvec3();
    let high = low + grid.step() * side;
    Some(Region { low: (low - room).max(grid.region.low), high: (high + room).min(grid.region.high) })
}

/// The outward direction at `voxel`: minus the gradient of the occupancy around it.
fn outwards(voxel: IVec3, is_occupied: impl Fn(IVec3) -> bool) -> DVec3 {
    let reach = || -2..=2;
    let offsets = reach().flat_map(|x| reach().flat_map(move |y| reach().map(move |z| IVec3::new(x, y, z))));
    let gradient: DVec3 = offsets
        .filter(|&offset| offset != IVec3::ZERO && is_occupied(voxel + offset))
        .map(|offset| offset.as_dvec3().normalize())
        .sum();
    (-gradient).try_normalize().unwrap_or(DVec3::Z)
}

/// The depth of the nearest point in each cell of a view.
struct DepthMap {
    /// px
    cell: f64,
    columns: usize,
    depths: Vec<f64>,
}

impl DepthMap {
    /// Cells are about as large as the image of a voxel of side `step` (world units) at the mean depth.
    fn new(camera: &Camera, points: &[DVec3], step: f64) -> Self {
        let seen: Vec<(f64, f64, f64)> = points.iter().filter_map(|&point| camera.project(point)).collect();
        let mean_depth = seen.iter().map(|p| p.2).sum::<f64>() / seen.len().max(1) as f64;
        let cell = (camera.fx.max(camera.fy) * step / mean_depth).clamp(1.0, 64.0);
        let count = |size: usize| (size as f64 / cell).ceil() as usize;
        let (columns, rows) = (count(camera.width), count(camera.height));
        let mut map = Self { cell, columns, depths: vec![f64::INFINITY; columns * rows] };
        for (x, y, depth) in seen {
            let (left, top) = ((x / cell - 0.5).floor(), (y / cell - 0.5).floor());
            for (column, row) in [(left, top), (left + 1.0, top), (left, top + 1.0), (left + 1.0, top + 1.0)] {
                if (0.0..columns as f64).contains(&column) && (0.0..rows as f64).contains(&row) {
                    let nearest = &mut map.depths[row as usize * columns + column as usize];
                    *nearest = nearest.min(depth);
                }
            }
        }
        map
    }

    /// The depth of the nearest point around `pixel` of a picture `width` px wide.
    fn at(&self, pixel: usize, width: usize) -> f64 {
        let cell = |px: usize| (px as f64 / self.cell) as usize;
        self.depths[cell(pixel / width) * self.columns + cell(pixel % width)]
    }
}

/// A point in a view that its surface faces: whether its colour can be trusted, how much it faces the view, its colour.
type Sighting = (bool, f64, [f32; 3]);

/// Inserts a sighting among the best [`VOTERS`], best first, behind those that are as good.
fn insert(best: &mut Vec<Sighting>, sighting: Sighting) {
    let is_better = |a: &Sighting| a.0.cmp(&sighting.0).then(a.1.total_cmp(&sighting.1)).is_ge();
    best.insert(best.partition_point(is_better), sighting);
    best.truncate(VOTERS);
}

/// The median colour of each point over the views that see it unobstructed and face it best; grey if there is none.
fn colours(silhouettes: &Silhouettes<'_>, points: &[DVec3], normals: &[DVec3], step: f64) -> Result<Vec<[f32; 3]>> {
    let mut best: Vec<Vec<Sighting>> = vec![Vec::new(); points.len()];
    for (view, picture) in silhouettes.pictures() {
        let (camera, picture) = (&view.camera, picture?);
        let (map, centre) = (DepthMap::new(camera, points, step), camera.centre());
        let surface = points.par_iter().zip(normals);
        best.par_iter_mut().zip(surface).for_each(|(best, (&point, &normal))| {
            let facing = (centre - point).normalize_or_zero().dot(normal);
            let Some((pixel, depth)) = camera.pixel(point).filter(|_| facing > 0.0) else { return };
            let unobstructed = depth <= map.at(pixel, camera.width) + HIDDEN_BEHIND * step;
            let is_opaque = picture.counts(pixel) && picture.alpha(pixel) > OPAQUE;
            insert(best, (unobstructed && is_opaque, facing, picture.colour(pixel)));
        });
    }
    let median = |mut views: Vec<Sighting>| {
        let trusted = views.iter().filter(|view| view.0).count();
        views.truncate(trusted.clamp(1, VOTERS));
        [0, 1, 2].map(|channel| {
            let mut values: Vec<f32> = views.iter().map(|view| view.2[channel]).collect();
            values.sort_by(f32::total_cmp);
            values.get(values.len() / 2).copied().unwrap_or(0.5)
        })
    };
    Ok(best.into_iter().map(median).collect())
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use dpges_core::camera::CameraFromWorld;

    use super::*;

    /// Pictures of a ball of radius 1: red where x > 0, else blue; white behind.
    fn photos(count: usize) -> Vec<View> {
        let photo = |i: usize| {
            let (turn, height) = (i as f64 / count as f64 * TAU * 7.0, 0.9 - 1.8 * i as f64 / count as f64);
            let eye = 4.0
                * DVec3::new(
                    turn.cos() * (1.0 - height * height).sqrt(),
                    turn.sin() * (1.0 - height * height).sqrt(),
                    height,
                );
            let camera_from_world = CameraFromWorld::look_at(eye, DVec3::ZERO, DVec3::Z);
            let camera = Camera {
                camera_from_world,
                fx: 140.0,
                fy: 140.0,
                cx: 50.0,
                cy: 50.0,
                width: 100,
                height: 100,
                near: 0.01,
                lens: None,
            };
            let (mut alpha, mut planes) = (vec![0; 10_000], vec![1.0f32; 30_000]);
            for pixel in 0..10_000 {
                let ray =
                    (camera.unproject((pixel % 100) as f64 + 0.5, (pixel / 100) as f64 + 0.5, 1.0) - eye).normalize();
                let (b, c) = (eye.dot(ray), eye.length_squared() - 1.0);
                if b * b >= c {
                    let hit = eye + ray * (-b - (b * b - c).sqrt());
                    alpha[pixel] = 255;
                    let colour = if hit.x > 0.0 { [1.0, 0.0, 0.0] } else { [0.0, 0.0, 1.0] };
                    (0..3).for_each(|channel| planes[channel * 10_000 + pixel] = colour[channel]);
                }
            }
            let picture = Picture { alpha: Some(alpha), ..Picture::from_planes(&planes, 100, 100) };
            View { name: i.to_string(), camera, photograph: picture.into(), depth: None }
        };
        (0..count).map(photo).collect()
    }

    fn hull(photos: &[View], resolution: usize, tolerance: f64) -> OrientedPoints {
        hull_points(&Silhouettes::new(photos).unwrap(), region(photos), resolution, tolerance).unwrap()
    }

    fn make_transparent(photo: &mut View) {
        photo.repaint(|picture| picture.alpha.as_mut().unwrap().fill(0)).unwrap();
    }

    fn region(photos: &[View]) -> Region {
        Region::in_sight(&photos.iter().map(|photo| &photo.camera).collect::<Vec<_>>(), 4.4)
    }

    #[test]
    fn the_hull_of_a_ball_is_a_ball() {
        let photos = photos(60);
        let found = hull(&photos, 48, 0.0);
        assert!(found.len() > 1500, "{}", found.len());
        let (mut well_coloured, mut coloured) = (0, 0);
        for ((position, normal), colour) in found.positions.iter().zip(&found.normals).zip(&found.colours) {
            let p = DVec3::from_array(position.map(f64::from));
            assert!((0.85..1.1).contains(&p.length()), "{p}");
            assert!(normal.dot(p.normalize()) > 0.8, "{p} {normal}");
            if p.x.abs() > 0.1 {
                coloured += 1;
                well_coloured += usize::from(*colour == if p.x > 0.0 { [1.0, 0.0, 0.0] } else { [0.0, 0.0, 1.0] });
            }
        }
        assert!(well_coloured as f64 > 0.99 * coloured as f64, "{well_coloured} of {coloured}");
    }

    #[test]
    fn one_wrong_mask_in_sixty_is_tolerated() {
        let mut photos = photos(60);
        make_transparent(&mut photos[7]);
        assert!(hull(&photos, 32, 0.0).is_empty());
        assert!(hull(&photos, 32, 0.02).len() > 500);
    }

    #[test]
    fn pixels_that_do_not_count_take_nothing_away() {
        let mut photos = photos(60);
        make_transparent(&mut photos[7]);
        let mut counted = vec![true; 10_000];
        counted[2500..7500].fill(false);
        photos[7].repaint(|picture| picture.counted = Some(counted)).unwrap();
        let found = hull(&photos, 32, 0.0);
        assert!(found.len() > 300, "what photo 7 shows in the middle is not carved away: {}", found.len());
    }

    #[test]
    fn disjoint_silhouettes_have_no_hull() {
        let mut photos = photos(4);
        photos.iter_mut().for_each(make_transparent);
        assert!(hull(&photos, 16, 0.0).is_empty());
    }
}
