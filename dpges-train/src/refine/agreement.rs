//! Where a pixel is in the world, judged by whether the photographs of other views have its colour there.

use crate::dataset::View;
use crate::views::exposure::Seen;

/// Other views that are asked: those whose cameras are nearest.
const ASKED_VIEWS: usize = 8;
/// Largest difference of a channel between colours that agree.
const SAME_COLOUR: f32 = 0.08;
/// Depths that are tried, relative to the depth that is assumed. The first of the best is taken.
const TRIED_DEPTHS: [f64; 7] = [1.0, 0.95, 1.05, 0.88, 1.14, 0.75, 1.33];

/// For each view, the others, nearest first.
pub fn nearest_views(views: &[View]) -> Vec<Vec<usize>> {
    let centres: Vec<_> = views.iter().map(|view| view.camera.centre()).collect();
    let of = |index: usize| {
        let mut others: Vec<usize> = (0..views.len()).filter(|&other| other != index).collect();
        let distance = |view: usize| centres[view].distance_squared(centres[index]);
        others.sort_by(|&a, &b| distance(a).total_cmp(&distance(b)).then(a.cmp(&b)));
        others.truncate(ASKED_VIEWS);
        others
    };
    (0..views.len()).map(of).collect()
}

/// The depth of pixel `pixel` of `view`, near the `assumed` one (world units), at which most of `others`
/// have the pixel's colour at a pixel that counts; `None` if fewer than `least` agree at any depth.
pub fn agreed_depth(view: &Seen<'_>, others: &[Seen<'_>], pixel: usize, assumed: f64, least: usize) -> Option<f64> {
    let width = view.camera.width;
    let (x, y) = ((pixel % width) as f64 + 0.5, (pixel / width) as f64 + 0.5);
    let colour = view.colour(pixel);
    let agreeing = |depth: f64| {
        let world = view.camera.unproject(x, y, depth);
        let agrees = |other: &&Seen<'_>| {
            let Some((pixel, _)) = other.camera.pixel(world) else { return false };
            other.picture.counts(pixel) && is_same(other.colour(pixel), colour)
        };
        others.iter().filter(agrees).count()
    };
    let mut best = (0, assumed);
    for factor in TRIED_DEPTHS {
        let count = agreeing(factor * assumed);
        if count > best.0 {
            best = (count, factor * assumed);
        }
    }
    (best.0 >= least).then_some(best.1)
}

fn is_same(a: [f32; 3], b: [f32; 3]) -> bool {
    a.iter().zip(b).all(|(a, b)| (a - b).abs() <= SAME_COLOUR)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dataset::{BuiltinOptions, builtin, builtin_geometry};
    use crate::views::exposure::{Correction, Corrections};

    /// Pixels of the built-in scene whose assumed depth is wrong by a factor that is tried.
    fn found(factor: f64, least: usize) -> (usize, usize, usize) {
        found_with(&Corrections::default(), factor, least)
    }

    fn found_with(corrections: &Corrections, factor: f64, least: usize) -> (usize, usize, usize) {
        let options = BuiltinOptions { width: 64, height: 64, train_views: 24, ..Default::default() };
        let views = builtin(&options).train;
        let others = nearest_views(&views);
        let (depth, _) = builtin_geometry(&views[0].camera);
        let seen = |view: usize| Seen::by(&views[view], corrections.of(view)).unwrap();
        let asked: Vec<Seen> = others[0].iter().map(|&other| seen(other)).collect();
        let own = seen(0);
        let (mut right, mut wrong, mut none) = (0, 0, 0);
        for pixel in (0..64 * 64).step_by(7) {
            let truth = f64::from(depth[pixel]);
            match agreed_depth(&own, &asked, pixel, truth * factor, least) {
                Some(depth) if (depth / truth - 1.0).abs() < 0.07 => right += 1,
                Some(_) => wrong += 1,
                None => none += 1,
            }
        }
        (right, wrong, none)
    }

    #[test]
    fn right_depths_are_confirmed_and_wrong_ones_corrected_more_often_than_not() {
        let (right, wrong, _) = found(1.0, 2);
        assert!(right > 5 * wrong, "{right} right, {wrong} wrong");
        let (corrected, left_wrong, _) = found(1.0 / 0.75, 2);
        assert!(corrected > left_wrong, "{corrected} corrected, {left_wrong} not");
    }

    #[test]
    fn colours_are_compared_with_exposures_undone() {
        // as if the first photograph were twice as bright as the scene: nothing has half of its colours
        let gain = |view: usize| if view == 0 { 2.0 } else { 1.0 };
        let wrong = (0..24).map(|view| Correction { gain: [gain(view); 3], offset: [0.0; 3] });
        let (right, ..) = found(1.0, 2);
        let (with_wrong, ..) = found_with(&Corrections(wrong.collect()), 1.0, 2);
        assert!(2 * with_wrong < right, "{with_wrong} of {right}");
        let equal = vec![Correction { gain: [1.25; 3], offset: [0.1; 3] }; 24];
        let (with_equal, ..) = found_with(&Corrections(equal), 1.0, 2);
        assert!(10 * with_equal > 9 * right, "{with_equal} of {right}");
    }

    #[test]
    fn more_views_are_harder_to_convince() {
        let refused = |least: usize| found(1.0, least).2;
        assert!(refused(2) < refused(6) && refused(9) == 586, "{} {}", refused(2), refused(6));
    }
}
