//! Initialisation from the visual hull of pictures with alpha (Laurentini): what lies inside every silhouette.

use dpges_core::Result;
use glam::{DVec3, IVec3};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

use super::plane_sweep::{self, Acceptance, Sweep, Volume};
use super::region::Region;
use crate::dataset::{PointCloud, View, pictures};

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

    /// Of the voxel at a position, world units.
    fn index(&self, position: DVec3) -> Option<usize> {
        let voxel = ((position - self.region.low) / self.step()).floor().as_ivec3();
        let inside = voxel.min_element() >= 0 && voxel.max_element() < self.sides as i32;
        inside.then(|| voxel.to_array().into_iter().rev().fold(0, |index, at| index * self.sides + at as usize))
    }

    fn centre(&self, voxel: IVec3) -> DVec3 {
        self.region.low + self.step() * (voxel.as_dvec3() + 0.5)
    }
}

/// Share of the views whose silhouettes may miss a voxel of a run's visual hull: masks are not exact.
pub const TOLERANCE: f64 = 0.02;

/// At most `count` points inside of the visual hull of `views`, whose alpha says what is outside, within `region`, where views
/// agree about colours: hulls fill what is hollow. Where colours say nothing, points lie on the surface of the hull. It
/// consists of `resolution` voxels along each side of a grid that is fitted to the occupied part of the region. A voxel is
/// occupied if at least half of the views show its centre and at most the share `tolerance` of these show it outside their
/// silhouette. Empty if the silhouettes have no volume in common.
///
/// # Errors
/// [`dpges_core::Error::Io`] if a photograph cannot be read again.
pub fn hull_points(
    views: &[&View],
    region: Region,
    resolution: usize,
    tolerance: f64,
    count: usize,
    rng: &mut ChaCha8Rng,
) -> Result<PointCloud> {
    let coarse = Grid { region, sides: resolution.div_ceil(2) };
    let region = occupied_region(&coarse, &carve(&coarse, views, tolerance)?).unwrap_or(region);
    let grid = Grid { region, sides: resolution };
    let occupied = carve(&grid, views, tolerance)?;
    let contains = |position: DVec3| grid.index(position).is_some_and(|index| occupied[index]);
    let step = grid.region.size().max_element() / (2 * resolution) as f64;
    let sweep = Sweep::Volume(Volume { region: grid.region, step, contains: &contains });
    plane_sweep::draw(views, &sweep, Acceptance::ALL, count, rng)
}

/// How many views show a voxel, and how many of these show it outside of their silhouettes.
#[derive(Clone, Copy, Default)]
struct Shown {
    seen: u32,
    misses: u32,
}

fn carve(grid: &Grid, views: &[&View], tolerance: f64) -> Result<Vec<bool>> {
    let most_misses = tolerance * views.len() as f64;
    let mut shown = vec![Shown::default(); grid.len()];
    for (view, picture) in pictures(views.iter().copied()) {
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
        seen > 0 && 2 * seen as usize >= views.len() && f64::from(misses) <= tolerance * f64::from(seen)
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

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use rand::SeedableRng;

    use super::*;
    use crate::dataset::Picture;

    /// Pictures of a ball of radius 1: red where x > 0, else blue; white behind.
    fn photos(count: usize) -> Vec<View> {
        let photo = |i: usize| {
            let (turn, height) = (i as f64 / count as f64 * TAU * 7.0, 0.9 - 1.8 * i as f64 / count as f64);
            let radius = (1.0 - height * height).sqrt();
            let eye = 4.0 * DVec3::new(turn.cos() * radius, turn.sin() * radius, height);
            let camera = plane_sweep::tests::camera(eye, 100, 140.0);
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
            View { name: i.to_string(), camera, photograph: picture.into(), depth: None, face: None }
        };
        (0..count).map(photo).collect()
    }

    fn hull(photos: &[View], resolution: usize, tolerance: f64) -> PointCloud {
        let mut rng = ChaCha8Rng::seed_from_u64(6);
        let views: Vec<&View> = photos.iter().collect();
        hull_points(&views, region(photos), resolution, tolerance, 30_000, &mut rng).unwrap()
    }

    fn make_transparent(photo: &mut View) {
        photo.repaint(|picture| picture.alpha.as_mut().unwrap().fill(0)).unwrap();
    }

    fn region(photos: &[View]) -> Region {
        Region::in_sight(&photos.iter().map(|photo| photo.camera).collect::<Vec<_>>(), 4.4)
    }

    #[test]
    fn the_hull_of_a_ball_is_a_ball() {
        let photos = photos(60);
        let found = hull(&photos, 48, 0.0);
        // of 48 voxels along each side
        assert!(found.positions.len() > 20_000, "{}", found.positions.len());
        let (mut well_coloured, mut coloured, mut outermost) = (0, 0, 0.0f64);
        for (position, colour) in found.positions.iter().zip(&found.colours) {
            let p = DVec3::from_array(position.map(f64::from));
            outermost = outermost.max(p.length());
            if p.length() > 0.9 && p.x.abs() > 0.2 {
                coloured += 1;
                let channel = if p.x > 0.0 { 0 } else { 2 };
                well_coloured += usize::from(colour[channel] > 0.9 && colour[2 - channel] < 0.1);
            }
        }
        assert!((0.95..1.1).contains(&outermost) && coloured > 1000, "{outermost} {coloured}");
        assert!(well_coloured as f64 > 0.99 * coloured as f64, "{well_coloured} of {coloured}");
    }

    #[test]
    fn one_wrong_mask_in_sixty_is_tolerated() {
        let mut photos = photos(60);
        make_transparent(&mut photos[7]);
        assert!(hull(&photos, 32, 0.0).positions.is_empty());
        assert!(hull(&photos, 32, 0.02).positions.len() > 500);
    }

    #[test]
    fn pixels_that_do_not_count_take_nothing_away() {
        let mut photos = photos(60);
        make_transparent(&mut photos[7]);
        let mut counted = vec![true; 10_000];
        counted[2500..7500].fill(false);
        photos[7].repaint(|picture| picture.counted = Some(counted)).unwrap();
        let found = hull(&photos, 32, 0.0);
        let count = found.positions.len();
        assert!(count > 300, "what photo 7 shows in the middle is not carved away: {count}");
    }
}
