//! Photographs that were taken twice: from the same place, in the same direction, of the same.

use super::finding::{Finding, Kind};
use super::poses::spread;
use super::view::ViewFacts;
use crate::dataset::check::luma::Luma;

/// Limits for the same pose: distance relative to the spread of the cameras, angle between the directions, rad.
const DISTANCE: f64 = 0.005;
const ANGLE: f64 = 0.01;
/// Root mean square difference of thumbnails that show the same.
const DIFFERENCE: f64 = 0.02;
/// Side of a thumbnail, px.
const SIDE: usize = 16;
/// Pixels that two thumbnails must have to be compared.
const FEWEST_PIXELS: usize = SIDE * SIDE / 4;

/// The luma of a picture in 16 × 16 px; `None` at those that stand for a pixel that does not count.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Thumbnail(Vec<Option<f32>>);

impl Thumbnail {
    /// Each pixel is the mean of those that it stands for.
    pub fn of(luma: &Luma) -> Self {
        let range = |index: usize, length: usize| {
            let from = index * length / SIDE;
            from..((index + 1) * length / SIDE).max(from + 1).min(length)
        };
        let mean = |row: usize, column: usize| {
            let (rows, columns) = (range(row, luma.height), range(column, luma.width));
            let count = (rows.len() * columns.len()).max(1) as f32;
            let mut sum = 0.0;
            for y in rows {
                let pixels = y * luma.width + columns.start..y * luma.width + columns.end;
                if luma.counted.as_ref().is_some_and(|counted| counted[pixels.clone()].contains(&false)) {
                    return None;
                }
                sum += luma.values[pixels].iter().sum::<f32>();
            }
            Some(sum / count)
        };
        Self((0..SIDE * SIDE).map(|pixel| mean(pixel / SIDE, pixel % SIDE)).collect())
    }

    /// Root mean square; `None` if they have too little in common.
    fn difference(&self, other: &Self) -> Option<f64> {
        let pairs = self.0.iter().zip(&other.0).filter_map(|(a, b)| Some(f64::from((*a)? - (*b)?)));
        let squares: Vec<f64> = pairs.map(|difference| difference * difference).collect();
        (squares.len() >= FEWEST_PIXELS).then(|| (squares.iter().sum::<f64>() / squares.len() as f64).sqrt())
    }
}

/// The views that show what one before them shows.
pub(super) fn duplicates(views: &[ViewFacts]) -> Option<Finding> {
    let reach = DISTANCE * spread(views);
    let is_same = |a: &ViewFacts, b: &ViewFacts| {
        let [pose, other] = [a, b].map(|view| view.camera.camera_from_world);
        let near = a.camera.centre().distance(b.camera.centre()) <= reach;
        let [forward, forward_of_other] = [pose, other].map(|pose| pose.rotation.row(2));
        let shows_the_same = || match (&a.thumbnail, &b.thumbnail) {
            (Some(a), Some(b)) => a.difference(b).is_some_and(|difference| difference < DIFFERENCE),
            _ => false,
        };
        near && forward.angle_between(forward_of_other) < ANGLE && shows_the_same()
    };
    let mut originals: Vec<Option<&str>> = Vec::with_capacity(views.len());
    for (index, view) in views.iter().enumerate() {
        originals.push(views[..index].iter().find(|before| is_same(before, view)).map(|before| before.name.as_str()));
    }
    let repeated: Vec<&ViewFacts> =
        views.iter().zip(&originals).filter(|(_, original)| original.is_some()).map(|(view, _)| view).collect();
    let original = |view: &ViewFacts| {
        let index = views.iter().position(|other| std::ptr::eq(other, view))?;
        originals[index]
    };
    Finding::of_views(
        Kind::Duplicate,
        &repeated,
        ["a photograph is there twice", "photographs are there twice"],
        |view| original(view).map(|name| format!(" (like {name})")).unwrap_or_default(),
        "leave one of each out: a held-out view that is trained on as well makes scores look better than they are",
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn thumbnails_are_means_of_pictures_of_any_size() {
        let values = (0..32 * 48).map(|i| (i % 2) as f32).collect();
        let mut large = Luma { width: 32, height: 48, values, counted: None };
        assert_eq!(Thumbnail::of(&large), Thumbnail(vec![Some(0.5); SIDE * SIDE]));
        let small = Luma { width: 3, height: 1, values: vec![0.25; 3], counted: None };
        let thumbnail = Thumbnail::of(&small);
        assert_eq!(thumbnail, Thumbnail(vec![Some(0.25); SIDE * SIDE]));
        let difference = |large: &Luma| thumbnail.difference(&Thumbnail::of(large));
        assert!((difference(&large).unwrap() - 0.25).abs() < 1e-7);

        // a pixel stands for 2 × 3: those of the first five columns have to do with what does not count
        large.counted = Some((0..32 * 48).map(|i| i % 32 >= 9).collect());
        (0..32 * 48).filter(|i| i % 32 < 9).for_each(|i| large.values[i] = 7.0);
        let masked = Thumbnail::of(&large);
        assert!((0..SIDE * SIDE).all(|pixel| masked.0[pixel] == (pixel % SIDE >= 5).then_some(0.5)), "{masked:?}");
        assert!((difference(&large).unwrap() - 0.25).abs() < 1e-7);
        large.counted = Some((0..32 * 48).map(|i| i % 32 >= 26).collect());
        assert_eq!(difference(&large), None, "they have 3 of 16 columns in common");
    }
}
