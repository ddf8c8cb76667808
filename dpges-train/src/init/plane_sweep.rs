//! Points on surfaces by plane sweep: where a pixel and the nearest other views agree about a colour (Collins: *A Space-Sweep
//! Approach to True Multi-Image Matching*. Computer Vision and Pattern Recognition, 1996).
//!
//! Rays of random pixels are followed through a volume. At each depth, the patch of pixels around a ray is compared with what
//! other views show there. On a surface with texture one depth alone looks alike in all of them. Where there is no texture
//! many do, and the nearest of these is the surface of the volume, if it is a visual hull.

use std::sync::Arc;

use dpges_core::Result;
use dpges_core::camera::Camera;
use glam::DVec3;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

use super::region::Region;
use crate::dataset::{Picture, PointCloud, View, sampled};

/// Views that a pixel is compared with.
const NEIGHBOURS: usize = 5;
/// Those of them that count, the most alike: what others see in front of the surface differs.
const MOST_ALIKE: usize = 3;
/// Pixels from the middle of a patch to its border.
const PATCH_RADIUS_PX: usize = 1;
/// A pixel with more than this alpha shows no background.
const OPAQUE: f32 = 0.9;
/// Differences of colours that are this much apart count as equal, from 0 to 1.
const EQUAL: f64 = 0.03;
/// The difference from views that show nothing at a point.
const NOT_SHOWN: f64 = 1.0;
/// Pixels that are tried for each point that is wanted, at most.
const TRIES: usize = 8;

/// Where rays are followed.
pub enum Sweep<'a> {
    Volume(Volume<'a>),
    /// To where next to nothing moves between views: the distances of the compared points of a ray from `nearest` (world
    /// units) on have equal differences of their inverses, so that a neighbour sees equal steps.
    Open {
        nearest: f64,
        steps: usize,
    },
}

/// A part of space.
pub struct Volume<'a> {
    pub region: Region,
    /// Distance between the compared points of a ray, world units.
    pub step: f64,
    /// Whether something may be at a point inside the region.
    pub contains: &'a (dyn Fn(DVec3) -> bool + Sync),
}

/// Which points are taken.
#[derive(Clone, Copy, Debug)]
pub struct Acceptance {
    /// Largest mean difference of colours from other views, from 0 to 1.
    pub most_different: f64,
    /// Largest share of a ray's points, of those that other views show, that look as much alike.
    pub most_ambiguous: f64,
}

impl Acceptance {
    /// All: a volume that bounds surfaces tightly is right where colours say nothing.
    pub const ALL: Self = Self { most_different: f64::INFINITY, most_ambiguous: f64::INFINITY };
    /// Those that colours alone determine.
    pub const DISTINCT: Self = Self { most_different: 0.06, most_ambiguous: 0.25 };
}

/// A compared point of a ray.
struct Sample {
    position: DVec3,
    /// Mean over the views that are most alike, of the channel that differs most, from 0 to 1.
    difference: f64,
}

/// A view and those that it is compared with.
struct Group<'a> {
    camera: &'a Camera,
    picture: Arc<Picture>,
    others: Vec<(&'a Camera, Arc<Picture>)>,
}

/// At most `count` points that `views` see in `volume`, equally many of each of a sample of the views. They have the colours of
/// the pixels that show them; of the views that see them, one is known.
///
/// # Errors
/// [`dpges_core::Error::Io`] if a photograph cannot be read again.
pub fn draw(
    views: &[&View],
    sweep: &Sweep<'_>,
    acceptance: Acceptance,
    count: usize,
    rng: &mut ChaCha8Rng,
) -> Result<PointCloud> {
    let numbers: Vec<usize> = sampled(views.len()).collect();
    let views: Vec<&View> = numbers.iter().map(|&number| views[number]).collect();
    let mut drawn = PointCloud::default();
    for (at, &number) in numbers.iter().enumerate() {
        let group = Group::new(&views, at)?;
        let mut missing = count * (at + 1) / views.len() - count * at / views.len();
        let mut pixels: Vec<usize> = (0..group.picture.area()).filter(|&pixel| shows(&group.picture, pixel)).collect();
        let (mut untried, _) = pixels.partial_shuffle(rng, TRIES * missing);
        while missing > 0 && !untried.is_empty() {
            let (tried, rest) = untried.split_at_mut(missing.min(untried.len()));
            let surface = |&pixel: &usize| Some((pixel, group.surface(pixel, sweep, acceptance)?));
            let found: Vec<(usize, DVec3)> = tried.par_iter().filter_map(surface).collect();
            missing -= found.len();
            untried = rest;
            for (pixel, position) in found {
                drawn.positions.push(position.as_vec3().to_array());
                drawn.colours.push(group.picture.colour(pixel));
                drawn.seen_by.push([number as u32]);
            }
        }
    }
    Ok(drawn)
}

impl<'a> Group<'a> {
    /// Of the view `at` and its nearest others. Of panoramas these are faces of others that look about the same way.
    fn new(views: &[&'a View], at: usize) -> Result<Self> {
        let distance = |other: usize| views[other].camera.centre().distance(views[at].camera.centre());
        let forward = |view: usize| views[view].camera.camera_from_world.rotation.row(2);
        let is_apart = |&other: &usize| {
            let is_other = views[other].photograph_name() != views[at].photograph_name();
            is_other && (views[other].face.is_none() || forward(other).dot(forward(at)) > 0.5)
        };
        let mut others: Vec<usize> = (0..views.len()).filter(is_apart).collect();
        others.sort_by(|&a, &b| distance(a).total_cmp(&distance(b)));
        others.truncate(NEIGHBOURS);
        let others = others.into_iter().map(|other| Ok((&views[other].camera, views[other].picture()?)));
        Ok(Self { camera: &views[at].camera, picture: views[at].picture()?, others: others.collect::<Result<_>>()? })
    }

    /// The nearest point on the ray of `pixel` that looks about as much alike as any.
    fn surface(&self, pixel: usize, sweep: &Sweep<'_>, acceptance: Acceptance) -> Option<DVec3> {
        let samples = self.samples(pixel, sweep);
        let least = samples.iter().map(|sample| sample.difference).min_by(f64::total_cmp)?;
        let is_alike = |sample: &Sample| sample.difference <= least + EQUAL;
        let number = |of: &dyn Fn(&Sample) -> bool| samples.iter().filter(|sample| of(sample)).count() as f64;
        let ambiguity = number(&is_alike) / number(&|sample| sample.difference < NOT_SHOWN).max(1.0);
        if least > acceptance.most_different || ambiguity > acceptance.most_ambiguous {
            return None;
        }
        let alike = &samples[samples.iter().position(is_alike)?..];
        let falls = alike.windows(2).take_while(|pair| pair[1].difference < pair[0].difference).count();
        Some(alike[falls].position)
    }

    fn samples(&self, pixel: usize, sweep: &Sweep<'_>) -> Vec<Sample> {
        let centre = self.camera.centre();
        let (ray, patch) = self.patch(pixel);
        let sample = |distance: f64| {
            let position = centre + distance * ray;
            Sample { position, difference: self.difference(centre, distance, &patch) }
        };
        match *sweep {
            Sweep::Volume(Volume { region, step, contains }) => {
                let (a, b) = ((region.low - centre) / ray, (region.high - centre) / ray);
                let (enter, leave) = (a.min(b).max_element().max(self.camera.near), a.max(b).min_element());
                let distances = (0..).map(|at| enter + (f64::from(at) + 0.5) * step);
                let inside = distances.take_while(|&distance| distance < leave);
                inside.filter(|&distance| contains(centre + distance * ray)).map(sample).collect()
            }
            Sweep::Open { nearest, steps } => {
                let share = |at: usize| (at as f64 + 0.5) / steps as f64;
                (0..steps).map(|at| sample(nearest / (1.0 - share(at)))).collect()
            }
        }
    }

    /// The ray of a pixel, a unit vector, and the rays and colours of the pixels around it; these rays end on the plane
    /// perpendicular to the first where that one does.
    fn patch(&self, pixel: usize) -> (DVec3, Vec<(DVec3, [f32; 3])>) {
        let Camera { width, height, .. } = *self.camera;
        let (x, y) = (pixel % width, pixel / width);
        let ray = |x: usize, y: usize| {
            (self.camera.unproject(x as f64 + 0.5, y as f64 + 0.5, 1.0) - self.camera.centre()).normalize()
        };
        let middle = ray(x, y);
        let around = |at: usize, end: usize| at.saturating_sub(PATCH_RADIUS_PX)..(at + PATCH_RADIUS_PX + 1).min(end);
        let pixels = around(y, height).flat_map(|y| around(x, width).map(move |x| (x, y)));
        let pixels = pixels.filter(|&(x, y)| shows(&self.picture, y * width + x));
        let patch = pixels.map(|(x, y)| (ray(x, y) / ray(x, y).dot(middle), self.picture.rgb(x, y))).collect();
        (middle, patch)
    }

    /// Mean difference between `patch` and the views that are most alike, at a distance from `centre` in world units.
    fn difference(&self, centre: DVec3, distance: f64, patch: &[(DVec3, [f32; 3])]) -> f64 {
        let of_pixel = |camera: &Camera, picture: &Picture, &(ray, colour): &(DVec3, [f32; 3])| {
            let (pixel, _) = camera.pixel(centre + distance * ray)?;
            let shown = picture.colour(pixel);
            let largest = (0..3).map(|at| (shown[at] - colour[at]).abs()).fold(0.0, f32::max);
            picture.counts(pixel).then(|| if shows(picture, pixel) { f64::from(largest) } else { NOT_SHOWN })
        };
        let of_view = |(camera, picture): &(&Camera, Arc<Picture>)| {
            let sum: Option<f64> = patch.iter().map(|of_ray| of_pixel(camera, picture, of_ray)).sum();
            sum.map(|sum| sum / patch.len() as f64)
        };
        let mut differences: Vec<f64> = self.others.iter().filter_map(of_view).collect();
        let count = MOST_ALIKE.min(self.others.len());
        if differences.len() < count {
            return NOT_SHOWN;
        }
        differences.sort_by(f64::total_cmp);
        differences[..count].iter().sum::<f64>() / count.max(1) as f64
    }
}

/// Whether the pixel counts and shows something before the background.
fn shows(picture: &Picture, pixel: usize) -> bool {
    picture.counts(pixel) && picture.alpha(pixel) > OPAQUE
}

#[cfg(test)]
pub(super) mod tests {
    use std::f64::consts::TAU;

    use dpges_core::camera::CameraFromWorld;
    use rand::SeedableRng;

    use super::*;

    const SIZE: usize = 64;

    /// Squares of 0.12 units on the plane z = 0, each of a colour of its own.
    pub fn mosaic(at: DVec3) -> [f32; 3] {
        let (x, y) = ((at.x / 0.12).floor() as i64, (at.y / 0.12).floor() as i64);
        [7, 13, 29].map(|factor| ((factor * x + 31 * factor * y + x * x * y).rem_euclid(17)) as f32 / 16.0)
    }

    fn grey(_: DVec3) -> [f32; 3] {
        [0.4; 3]
    }

    /// Looks at the origin, `size` px wide and high, of focal length `f` px.
    pub fn camera(eye: DVec3, size: usize, f: f64) -> Camera {
        let (camera_from_world, c) = (CameraFromWorld::look_at(eye, DVec3::ZERO, DVec3::Z), size as f64 / 2.0);
        let (fx, fy, cx, cy, width, height) = (f, f, c, c, size, size);
        Camera { camera_from_world, fx, fy, cx, cy, width, height, near: 0.01, lens: None }
    }

    /// Of a floor, from a ring above it. A wall with a pattern of its own hides it from every view whose number `is_blocked`.
    pub fn photos(floor: fn(DVec3) -> [f32; 3], is_blocked: impl Fn(usize) -> bool) -> Vec<View> {
        let photo = |number: usize| {
            let turn = number as f64 / 40.0 * TAU;
            let eye = DVec3::new(3.0 * turn.cos(), 3.0 * turn.sin(), 2.0 + (number % 3) as f64);
            let camera = camera(eye, SIZE, 100.0);
            let mut planes = vec![0.0; 3 * SIZE * SIZE];
            for pixel in 0..SIZE * SIZE {
                let ray = camera.unproject((pixel % SIZE) as f64 + 0.5, (pixel / SIZE) as f64 + 0.5, 1.0) - eye;
                let wall = [((7919 * pixel + 3571 * number) % 256) as f32 / 255.0; 3];
                let colour = if is_blocked(number) { wall } else { floor(eye - ray * eye.z / ray.z) };
                (0..3).for_each(|channel| planes[channel * SIZE * SIZE + pixel] = colour[channel]);
            }
            let picture = Picture::from_planes(&planes, SIZE, SIZE);
            View { name: number.to_string(), camera, photograph: picture.into(), depth: None, face: None }
        };
        (0..40).map(photo).collect()
    }

    /// From 0.6 below to 0.6 above the floor.
    fn drawn(photos: &[View], acceptance: Acceptance, count: usize) -> PointCloud {
        let region = Region { low: DVec3::new(-1.0, -1.0, -0.6), high: DVec3::new(1.0, 1.0, 0.6) };
        swept(photos, &Sweep::Volume(Volume { region, step: 0.03, contains: &|_| true }), acceptance, count)
    }

    fn swept(photos: &[View], sweep: &Sweep<'_>, acceptance: Acceptance, count: usize) -> PointCloud {
        let views: Vec<&View> = photos.iter().collect();
        draw(&views, sweep, acceptance, count, &mut ChaCha8Rng::seed_from_u64(2)).unwrap()
    }

    /// The share of the points near the floor.
    fn near(points: &PointCloud) -> f64 {
        points.positions.iter().filter(|at| at[2].abs() < 0.06).count() as f64 / points.positions.len() as f64
    }

    #[test]
    fn points_lie_on_the_surface_with_its_colour() {
        let points = drawn(&photos(mosaic, |_| false), Acceptance::DISTINCT, 400);
        let count = points.positions.len();
        assert!(count > 300 && points.colours.len() == count, "{count}");
        assert!(near(&points) > 0.9, "{}", near(&points));
        let (mut compared, mut right) = (0, 0);
        for (at, colour) in points.positions.iter().zip(&points.colours) {
            let inside_a_square = at[..2].iter().all(|x| (x / 0.12 - (x / 0.12).round()).abs() > 0.25);
            if at[2].abs() < 0.06 && inside_a_square {
                compared += 1;
                let true_colour = mosaic(DVec3::from_array(at.map(f64::from)));
                right += u32::from((0..3).all(|channel| (colour[channel] - true_colour[channel]).abs() < 0.01));
            }
        }
        assert!(compared > 20 && f64::from(right) > 0.8 * f64::from(compared), "{right} of {compared}");
        let shows_it = |(at, seen_by): (&[f32; 3], &[u32])| {
            let camera = &photos(mosaic, |_| false)[seen_by[0] as usize].camera;
            seen_by.len() == 1 && camera.pixel(DVec3::from_array(at.map(f64::from))).is_some()
        };
        let first = points.positions.iter().enumerate().take(20);
        assert!(first.map(|(row, at)| (at, points.seen_by.of(row))).all(shows_it));
    }

    #[test]
    fn a_sweep_without_an_end_finds_surfaces_near_and_far() {
        let photos = photos(mosaic, |_| false);
        // 192 steps from 0.5 to 190 units; the floor is 3 to 9 away
        let sweep = Sweep::Open { nearest: 0.5, steps: 192 };
        let points = swept(&photos, &sweep, Acceptance::DISTINCT, 400);
        assert!(points.positions.len() > 300 && near(&points) > 0.9, "{} {}", points.positions.len(), near(&points));
        let nothing_is_that_near = Sweep::Open { nearest: 40.0, steps: 192 };
        assert!(swept(&photos, &nothing_is_that_near, Acceptance::DISTINCT, 400).positions.len() < 40);
    }

    #[test]
    fn what_hides_a_surface_from_two_of_five_neighbours_does_not_matter() {
        let points = drawn(&photos(mosaic, |number| number % 5 == 0), Acceptance::DISTINCT, 400);
        assert!(points.positions.len() > 150 && near(&points) > 0.9, "{} {}", points.positions.len(), near(&points));
    }

    #[test]
    fn without_texture_points_lie_where_rays_enter_the_volume_or_are_left_out() {
        let photos = photos(grey, |_| false);
        let points = drawn(&photos, Acceptance::ALL, 400);
        assert_eq!(points.positions.len(), 400);
        let entered = |at: &[f32; 3]| at[2] > 0.55 || at[0].abs() > 0.95 || at[1].abs() > 0.95;
        assert!(points.positions.iter().all(entered));
        assert!(drawn(&photos, Acceptance::DISTINCT, 400).positions.is_empty());
    }

    #[test]
    fn one_view_determines_nothing() {
        let photos = &photos(mosaic, |_| false)[..1];
        assert!(drawn(photos, Acceptance::DISTINCT, 50).positions.is_empty());
        assert_eq!(drawn(photos, Acceptance::ALL, 50).positions.len(), 50);
    }

    #[test]
    fn pixels_are_drawn_once_each() {
        let mut photos = photos(mosaic, |_| false);
        photos.truncate(3);
        let points = drawn(&photos, Acceptance::ALL, 100_000);
        let distinct: std::collections::HashSet<_> = points.positions.iter().map(|at| at.map(f32::to_bits)).collect();
        assert!(points.positions.len() <= 3 * SIZE * SIZE && distinct.len() == points.positions.len());
    }
}
