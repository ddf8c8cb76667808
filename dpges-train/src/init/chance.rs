//! Whether points that no view is said to see are where photographs show them, more than chance would put them there.
//!
//! Programs write random points where nothing was measured (3DGS for scenes of Blender), and clouds can lie in another frame
//! than the cameras. Surfels at such points never leave: a start without points is better.

use std::sync::Arc;

use dpges_core::Result;
use glam::DVec3;
use rand::seq::IndexedRandom;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

use super::region::Region;
use crate::config::{Config, InitMethod};
use crate::dataset::{Dataset, Finding, Kind, PointCloud, View, sampled};

/// Points that are compared, at most.
const COMPARED: usize = 1000;
/// Fewer comparisons say nothing.
const LEAST_COMPARED: usize = 100;
/// A point that fewer views show is not compared.
const LEAST_VIEWS: usize = 3;
/// Standard deviations of a fair coin beyond which comparisons are no chance.
const SIGNIFICANT: f64 = 4.0;

/// `dataset` without its points if they look [random](random_points), which a warning then says. All that follows from points,
/// such as where the sky is, would be wrong with them. `init.method = "sfm"` keeps them.
///
/// # Errors
/// [`dpges_core::Error::Io`] if a photograph cannot be read again.
pub fn without_random_points(dataset: Arc<Dataset>, config: &Config) -> Result<Arc<Dataset>> {
    if config.init.method == InitMethod::Sfm {
        return Ok(dataset);
    }
    let Some(finding) = random_points(&dataset)? else { return Ok(dataset) };
    tracing::warn!("{finding}");
    Ok(Arc::new(Dataset { points: PointCloud::default(), ..(*dataset).clone() }))
}

/// Reports points without tracks that photographs do not confirm; `None` if there are none, or photographs confirm them.
///
/// # Errors
/// [`dpges_core::Error::Io`] if a photograph cannot be read again.
pub fn random_points(dataset: &Dataset) -> Result<Option<Finding>> {
    let (points, views) = (&dataset.points, dataset.train.iter().collect::<Vec<_>>());
    // a seed of its own: a run that goes on comes to the same verdict
    let rng = &mut ChaCha8Rng::seed_from_u64(0);
    let are_random = points.seen_by.are_unknown() && looks_random(points, &views, rng)?;
    Ok(are_random.then(|| Finding {
        kind: Kind::RandomPoints,
        views: Vec::new(),
        message: format!(
            "{} points agree with the photographs no better than random ones would: random points, a cloud in another frame \
             than the cameras, or wrong cameras",
            points.positions.len()
        ),
        advice: "training leaves them out; init.method = \"sfm\" keeps them",
    }))
}

/// Whether photographs say nothing for `points`: their colours are seen at their places no better than at those of other
/// points, and views agree about what is there no better than about random places among them. `false` where the points are too
/// few to tell, or all have one colour, which was then not measured.
///
/// # Errors
/// [`dpges_core::Error::Io`] if a photograph cannot be read again.
fn looks_random(points: &PointCloud, views: &[&View], rng: &mut ChaCha8Rng) -> Result<bool> {
    let Some(region) = Region::around(&points.positions) else { return Ok(false) };
    let of_one_colour = points.colours.iter().all(|colour| *colour == points.colours[0]);
    if of_one_colour || views.len() < LEAST_VIEWS {
        return Ok(false);
    }
    let rows: Vec<usize> = (0..points.positions.len()).collect();
    let rows: Vec<usize> = rows.sample(rng, COMPARED).copied().collect();
    let places = rows.iter().map(|&row| DVec3::from_array(points.positions[row].map(f64::from))).collect::<Vec<_>>();
    // a cube, since views agree about all places in the box of a flat scene
    let around = Region::cube((region.low + region.high) / 2.0, region.size().max_element() / 2.0);
    let elsewhere = |_: &usize| around.low + around.size() * DVec3::from_array([0; 3].map(|_| rng.random()));
    let elsewhere: Vec<DVec3> = rows.iter().map(elsewhere).collect();
    let seen = seen_colours(&[places, elsewhere].concat(), views)?;
    let (seen, seen_elsewhere) = seen.split_at(rows.len());

    let colour = |at: usize| points.colours[rows[at % rows.len()]];
    let by_colour = |at: usize| Some((mismatch(&seen[at], colour(at))?, mismatch(&seen[at], colour(at + 1))?));
    let by_place = |at: usize| Some((disagreement(&seen[at])?, disagreement(&seen_elsewhere[at])?));
    let better = |compare: &dyn Fn(usize) -> Option<(f32, f32)>| {
        let pairs: Vec<(f32, f32)> = (0..rows.len()).filter_map(compare).collect();
        is_better_than_chance(&pairs)
    };
    Ok(!better(&by_colour)
        && !better(&by_place)
        && seen.iter().filter(|seen| seen.len() >= LEAST_VIEWS).count() >= LEAST_COMPARED)
}

/// The colours of the opaque pixels that show each of `places`, in a sample of the views.
fn seen_colours(places: &[DVec3], views: &[&View]) -> Result<Vec<Vec<[f32; 3]>>> {
    let mut seen = vec![Vec::new(); places.len()];
    for view in sampled(views.len()).map(|number| views[number]) {
        let picture = view.picture()?;
        places.par_iter().zip(&mut seen).for_each(|(&place, seen)| {
            let pixel = view.camera.pixel(place).map(|(pixel, _)| pixel);
            seen.extend(
                pixel.filter(|&pixel| picture.counts(pixel) && picture.alpha(pixel) > 0.5).map(|at| picture.colour(at)),
            );
        });
    }
    Ok(seen)
}

/// How far `colour` is from what views show: that of the quarter that is nearest to it, since others see what is in front.
fn mismatch(seen: &[[f32; 3]], colour: [f32; 3]) -> Option<f32> {
    let mut distances: Vec<f32> = seen.iter().map(|seen| distance(*seen, colour)).collect();
    distances.sort_by(f32::total_cmp);
    (seen.len() >= LEAST_VIEWS).then(|| distances[seen.len() / 4])
}

/// Mean distance from the median colour of the half of the views that is nearest to it.
fn disagreement(seen: &[[f32; 3]]) -> Option<f32> {
    let half = seen.len() / 2 + 1;
    let median = |channel: usize| {
        let mut values: Vec<f32> = seen.iter().map(|colour| colour[channel]).collect();
        values.sort_by(f32::total_cmp);
        values[seen.len() / 2]
    };
    (seen.len() >= LEAST_VIEWS).then(|| {
        let middle = [0, 1, 2].map(median);
        let mut distances: Vec<f32> = seen.iter().map(|colour| distance(*colour, middle)).collect();
        distances.sort_by(f32::total_cmp);
        distances[..half].iter().sum::<f32>() / half as f32
    })
}

fn distance(a: [f32; 3], b: [f32; 3]) -> f32 {
    (0..3).map(|channel| (a[channel] - b[channel]).abs()).fold(0.0, f32::max)
}

/// Whether the first of a pair is smaller more often than a fair coin would explain. Equal pairs say nothing.
fn is_better_than_chance(pairs: &[(f32, f32)]) -> bool {
    let smaller = pairs.iter().filter(|(measured, chance)| measured < chance).count() as f64;
    let unequal = pairs.iter().filter(|(measured, chance)| measured != chance).count() as f64;
    smaller > unequal / 2.0 + SIGNIFICANT * unequal.sqrt() / 2.0
}

#[cfg(test)]
mod tests {
    use super::super::plane_sweep::tests::{mosaic, photos};
    use super::*;

    /// 400 points of the floor that `photos` show, and what is made of them.
    fn floor(change: impl Fn(usize, DVec3) -> (DVec3, [f32; 3])) -> PointCloud {
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        let mut point = || DVec3::new(rng.random::<f64>() * 1.6 - 0.8, rng.random::<f64>() * 1.6 - 0.8, 0.0);
        let points: Vec<(DVec3, [f32; 3])> = (0..400).map(|at| change(at, point())).collect();
        let positions = points.iter().map(|(at, _)| at.as_vec3().to_array()).collect();
        PointCloud { positions, colours: points.iter().map(|(_, colour)| *colour).collect(), ..PointCloud::default() }
    }

    fn is_random(points: &PointCloud) -> bool {
        let views = photos(mosaic, |_| false);
        let views: Vec<&View> = views.iter().collect();
        looks_random(points, &views, &mut ChaCha8Rng::seed_from_u64(1)).unwrap()
    }

    fn any(at: usize, channel: usize) -> f32 {
        ((7919 * at + 104_729 * channel) % 251) as f32 / 250.0
    }

    fn any_colour(at: usize) -> [f32; 3] {
        [0, 1, 2].map(|channel| any(at, channel))
    }

    fn any_place(at: usize) -> DVec3 {
        DVec3::from_array([3, 4, 5].map(|channel| f64::from(any(at * at, channel)) * 1.6 - 0.8))
    }

    #[test]
    fn measured_points_are_kept_and_random_ones_are_not() {
        assert!(!is_random(&floor(|_, at| (at, mosaic(at)))));
        assert!(is_random(&floor(|number, _| (any_place(number), any_colour(number)))));
    }

    #[test]
    fn false_colours_and_no_colours_are_no_reason() {
        assert!(!is_random(&floor(|number, at| (at, any_colour(number)))), "views agree about these places");
        assert!(!is_random(&floor(|number, _| (any_place(number), [0.5; 3]))), "a cloud without colours");
    }

    #[test]
    fn a_cloud_in_another_frame_says_nothing() {
        assert!(is_random(&floor(|_, at| (DVec3::new(at.z, 0.9 * at.x + 0.3, at.y), mosaic(at)))));
    }

    #[test]
    fn few_points_are_not_judged() {
        let mut points = floor(|number, _| (any_place(number), any_colour(number)));
        points.positions.truncate(40);
        points.colours.truncate(40);
        assert!(!is_random(&points));
    }
}
