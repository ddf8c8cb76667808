//! Where views agree about a colour: on surfaces, as far as these have texture (Kutulakos, Seitz: *A Theory of Shape by Space
//! Carving*. International Journal of Computer Vision 38(3), 2000).
//!
//! Views from nearby see the same surfaces, so that those of one group agree about a point of a surface whatever hides it from
//! the others. Points in free space and inside of things show surfaces behind or before them, which move from view to view.

use std::sync::Arc;

use dpges_core::Result;
use glam::DVec3;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

use super::placement::OrientedPoints;
use crate::dataset::{Picture, View, pictures};

/// Views of a group.
const GROUP: usize = 6;
/// Most views that are compared, evenly chosen.
const MOST_VIEWS: usize = 100;
/// Most points that are compared, drawn at random: 80 MB of colours.
const MOST_POINTS: usize = 200_000;
/// A pixel with more than this alpha shows no background.
const OPAQUE: f32 = 0.9;
/// Standard deviation of a colour at which a point is drawn e times less often than where there is none.
const DEVIATION: f64 = 0.08;
/// Smallest probability of a point relative to the largest: shiny and coarse things agree nowhere.
const LEAST_WEIGHT: f64 = 0.02;
/// Power of the distance by which nearer views count more.
const NEARNESS: i32 = 8;

/// The colour that groups of views show at a point, and how well they agree about it.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Agreement {
    /// Standard deviation over the group that agrees best, of the channel that differs most, from 0 to 1.
    deviation: f64,
    /// Mean over the groups that agree about as well, from 0 to 1.
    colour: [f32; 3],
    /// Towards the views, a unit vector.
    direction: DVec3,
}

/// The colours that one group of views shows at a point.
struct OfGroup {
    /// As in [`Agreement`].
    deviation: f64,
    /// Mean, from 0 to 1.
    colour: DVec3,
    /// From the point to the middle of the views, world units.
    towards: DVec3,
}

impl Agreement {
    /// Of views that see nothing there.
    const NONE: Self = Self { deviation: 1.0, colour: [0.5; 3], direction: DVec3::Z };
}

/// At most `count` of `points` (world units), where neighbouring ones of `views` agree best about a colour, and seldom elsewhere. They have
/// the colour and the direction of the views that agree best.
///
/// # Errors
/// [`dpges_core::Error::Io`] if a photograph cannot be read again.
///
/// # Panics
/// Without views.
pub fn draw(views: &[&View], points: &[DVec3], count: usize, rng: &mut ChaCha8Rng) -> Result<OrientedPoints> {
    let compared = super::placement::draw_rows(points.len(), MOST_POINTS.max(count), rng);
    let points: Vec<DVec3> = compared.into_iter().map(|row| points[row]).collect();
    let agreements = agreements(views, &points)?;
    let mut drawn = OrientedPoints::default();
    for row in draw_weighted(&agreements, count, rng) {
        drawn.positions.push(points[row].as_vec3().to_array());
        drawn.colours.push(agreements[row].colour);
        drawn.normals.push(agreements[row].direction);
    }
    Ok(drawn)
}

/// At most `count` rows, without replacement, with probabilities by their weights (Efraimidis, Spirakis: *Weighted random
/// sampling with a reservoir*. Information Processing Letters 97(5), 2006); ascending.
fn draw_weighted(agreements: &[Agreement], count: usize, rng: &mut ChaCha8Rng) -> Vec<usize> {
    let weight = |agreement: &Agreement| weight(agreement.deviation).max(LEAST_WEIGHT);
    let mut keys: Vec<(f64, usize)> = agreements
        .iter()
        .enumerate()
        .map(|(row, agreement)| ((1.0 - rng.random::<f64>()).ln() / weight(agreement), row))
        .collect();
    keys.sort_by(|a, b| b.0.total_cmp(&a.0));
    let mut rows: Vec<usize> = keys.into_iter().take(count).map(|(_, row)| row).collect();
    rows.sort_unstable();
    rows
}

/// The agreement of views at each of `points`. A view and its nearest neighbours are a group, if all of them see the point.
fn agreements(views: &[&View], points: &[DVec3]) -> Result<Vec<Agreement>> {
    let views: Vec<&View> = views.iter().step_by(views.len().div_ceil(MOST_VIEWS)).copied().collect();
    let centres: Vec<DVec3> = views.iter().map(|view| view.camera.centre()).collect();
    let groups: Vec<Vec<usize>> = centres.iter().map(|&centre| nearest(&centres, centre)).collect();
    let mut seen: Vec<Option<[u8; 3]>> = vec![None; points.len() * views.len()];
    for (at, (view, picture)) in pictures(views.iter().copied()).enumerate() {
        let picture: Arc<Picture> = picture?;
        seen.par_chunks_mut(views.len()).zip(points).for_each(|(seen, &point)| {
            let pixel = view.camera.pixel(point).map(|(pixel, _)| pixel);
            let shown = pixel.filter(|&pixel| picture.counts(pixel) && picture.alpha(pixel) > OPAQUE);
            seen[at] = shown.map(|pixel| std::array::from_fn(|channel| picture.bytes[3 * pixel + channel]));
        });
    }
    let agreement = |(seen, &point): (&[Option<[u8; 3]>], &DVec3)| {
        let of_groups = groups.iter().filter_map(|group| {
            let colours: Option<Vec<[u8; 3]>> = group.iter().map(|&view| seen[view]).collect();
            let (deviation, colour) = spread(&colours?);
            let towards = group.iter().map(|&view| centres[view] - point).sum::<DVec3>() / group.len() as f64;
            Some(OfGroup { deviation, colour, towards })
        });
        mean(&of_groups.collect::<Vec<_>>())
    };
    Ok(seen.par_chunks(views.len()).zip(points).map(agreement).collect())
}

/// The least deviation of `groups`, with means of those that agree about as well; nearer ones count more, since what has one
/// colour in front and another one behind looks alike to the views on either side.
fn mean(groups: &[OfGroup]) -> Agreement {
    let Some(deviation) = groups.iter().map(|group| group.deviation).min_by(f64::total_cmp) else {
        return Agreement::NONE;
    };
    let nearest = groups.iter().map(|group| group.towards.length()).fold(f64::INFINITY, f64::min);
    let (mut weights, mut colour, mut direction) = (0.0, DVec3::ZERO, DVec3::ZERO);
    for group in groups {
        let nearness = (nearest / group.towards.length()).powi(NEARNESS);
        let weight = nearness * weight(group.deviation) / weight(deviation);
        weights += weight;
        colour += weight * group.colour;
        direction += weight * group.towards.normalize_or_zero();
    }
    let colour = (colour / weights).to_array().map(|channel| channel as f32);
    Agreement { deviation, colour, direction: direction.try_normalize().unwrap_or(DVec3::Z) }
}

/// The weight of a deviation of colours, at most 1.
fn weight(deviation: f64) -> f64 {
    (-(deviation / DEVIATION).powi(2)).exp()
}

/// The [`GROUP`] of `centres` nearest to `centre`.
fn nearest(centres: &[DVec3], centre: DVec3) -> Vec<usize> {
    let mut order: Vec<usize> = (0..centres.len()).collect();
    order.sort_by(|&a, &b| centres[a].distance(centre).total_cmp(&centres[b].distance(centre)));
    order.truncate(GROUP);
    order
}

/// Largest standard deviation of a channel, and the mean, both from 0 to 1.
fn spread(colours: &[[u8; 3]]) -> (f64, DVec3) {
    let colours = || colours.iter().map(|colour| DVec3::from_array(colour.map(|byte| f64::from(byte) / 255.0)));
    let count = colours().count() as f64;
    let mean = colours().sum::<DVec3>() / count;
    let variance = colours().map(|colour| (colour - mean).powf(2.0)).sum::<DVec3>() / count;
    (variance.max_element().sqrt(), mean)
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use dpges_core::camera::{Camera, CameraFromWorld};
    use rand::SeedableRng;

    use super::*;

    const SIZE: usize = 64;

    /// Squares of a quarter of a unit on the plane z = 0, green or red with some blue.
    fn floor(at: DVec3) -> [f32; 3] {
        let square = (4.0 * at.x).floor() + (4.0 * at.y).floor();
        if square.rem_euclid(2.0) < 1.0 { [0.0, 1.0, 0.0] } else { [1.0, 0.0, 0.5] }
    }

    /// Of the floor, from a ring above it. A wall with a pattern hides it from every view whose number `is_blocked`.
    fn photos(is_blocked: impl Fn(usize) -> bool) -> Vec<View> {
        let photo = |number: usize| {
            let turn = number as f64 / 40.0 * TAU;
            let eye = DVec3::new(3.0 * turn.cos(), 3.0 * turn.sin(), 2.0 + (number % 3) as f64);
            let camera_from_world = CameraFromWorld::look_at(eye, DVec3::ZERO, DVec3::Z);
            let (f, c) = (100.0, SIZE as f64 / 2.0);
            let camera = Camera {
                camera_from_world,
                fx: f,
                fy: f,
                cx: c,
                cy: c,
                width: SIZE,
                height: SIZE,
                near: 0.01,
                lens: None,
            };
            let mut planes = vec![0.0; 3 * SIZE * SIZE];
            for pixel in 0..SIZE * SIZE {
                let ray = camera.unproject((pixel % SIZE) as f64 + 0.5, (pixel / SIZE) as f64 + 0.5, 1.0) - eye;
                let wall = [((7919 * pixel + 3571 * number) % 256) as f32 / 255.0; 3];
                let colour = if is_blocked(number) { wall } else { floor(eye - ray * eye.z / ray.z) };
                (0..3).for_each(|channel| planes[channel * SIZE * SIZE + pixel] = colour[channel]);
            }
            let picture = Picture::from_planes(&planes, SIZE, SIZE);
            View { name: number.to_string(), camera, photograph: picture.into(), depth: None }
        };
        (0..40).map(photo).collect()
    }

    /// Columns of points from 0.6 below to 0.6 above the floor, and their heights.
    fn columns() -> (Vec<DVec3>, Vec<f64>) {
        let heights = (-6..=6).map(|step| 0.1 * f64::from(step));
        let places =
            (0..100).map(|at| DVec3::new(0.08 * f64::from(at % 10) - 0.37, 0.08 * f64::from(at / 10) - 0.33, 0.0));
        let points: Vec<DVec3> =
            places.flat_map(|place| heights.clone().map(move |height| place + height * DVec3::Z)).collect();
        let heights = points.iter().map(|point| point.z).collect();
        (points, heights)
    }

    fn drawn(photos: &[View], count: usize) -> OrientedPoints {
        let views: Vec<&View> = photos.iter().collect();
        draw(&views, &columns().0, count, &mut ChaCha8Rng::seed_from_u64(2)).unwrap()
    }

    #[test]
    fn points_are_drawn_at_the_surface_even_if_it_is_hidden_from_half_of_the_views() {
        for photos in [photos(|_| false), photos(|number| number >= 20)] {
            let points = drawn(&photos, 200);
            assert_eq!((points.len(), points.colours.len(), points.normals.len()), (200, 200, 200));
            let at_the_surface = points.positions.iter().filter(|at| at[2].abs() < 0.15).count();
            // 3 of 13 heights
            assert!(at_the_surface > 75, "{at_the_surface} of 200, by chance 46");
        }
    }

    #[test]
    fn points_have_the_colour_of_the_surface_and_face_the_views() {
        let points = drawn(&photos(|_| false), 400);
        let mut compared = 0;
        for ((at, colour), normal) in points.positions.iter().zip(&points.colours).zip(&points.normals) {
            assert!((normal.length() - 1.0).abs() < 1e-9 && normal.z > 0.3, "{normal}");
            let inside_a_square = at[..2].iter().all(|x| (4.0 * x - (4.0 * x).round()).abs() > 0.2);
            if at[2].abs() < 0.05 && inside_a_square {
                compared += 1;
                let true_colour = floor(DVec3::from_array(at.map(f64::from)));
                assert!(
                    (0..3).all(|channel| (colour[channel] - true_colour[channel]).abs() < 0.1),
                    "{at:?} {colour:?}"
                );
            }
        }
        assert!(compared > 10, "{compared}");
    }

    #[test]
    fn without_views_that_see_them_points_are_drawn_alike() {
        let far: Vec<DVec3> = (0..50).map(|at| DVec3::new(1e4, f64::from(at), 0.0)).collect();
        let photos = photos(|_| false);
        for views in [photos.iter().collect::<Vec<_>>(), vec![&photos[0]]] {
            let points = draw(&views, &far, 20, &mut ChaCha8Rng::seed_from_u64(2)).unwrap();
            assert_eq!((points.len(), points.colours[0], points.normals[0]), (20, [0.5; 3], DVec3::Z));
        }
        assert!(draw(&[&photos[0]], &[], 5, &mut ChaCha8Rng::seed_from_u64(2)).unwrap().is_empty());
    }

    #[test]
    fn rows_are_drawn_by_their_weights_and_once_each() {
        let of = |deviation| Agreement { deviation, ..Agreement::NONE };
        let agreements: Vec<Agreement> = (0..1000).map(|row| of(if row % 10 == 0 { 0.0 } else { 0.5 })).collect();
        let rows = draw_weighted(&agreements, 110, &mut ChaCha8Rng::seed_from_u64(1));
        assert!(rows.len() == 110 && rows.windows(2).all(|pair| pair[0] < pair[1]));
        let best = rows.iter().filter(|&row| row % 10 == 0).count();
        assert!((60..=100).contains(&best), "{best} of 100 good ones");
        assert_eq!(draw_weighted(&agreements, 2000, &mut ChaCha8Rng::seed_from_u64(1)).len(), 1000);
    }
}
