//! Photographs that were taken twice: from the same place, in the same direction, of the same.

use super::finding::{Finding, Kind};
use super::poses::spread;
use super::view::ViewFacts;
use crate::sharpness::Luma;

/// Of one pose: distance relative to the spread of the cameras, angle between the directions, rad.
const DISTANCE: f64 = 0.005;
const ANGLE: f64 = 0.01;
/// Root mean square difference of thumbnails that show the same.
const DIFFERENCE: f64 = 0.02;
/// Side of a thumbnail, px.
const SIDE: usize = 16;

/// The luma of a picture in 16 × 16 px.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Thumbnail(Vec<f32>);

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
            rows.map(|y| luma.values[y * luma.width..][columns.clone()].iter().sum::<f32>()).sum::<f32>() / count
        };
        Self((0..SIDE * SIDE).map(|pixel| mean(pixel / SIDE, pixel % SIDE)).collect())
    }

    fn difference(&self, other: &Self) -> f64 {
        let squares = self.0.iter().zip(&other.0).map(|(a, b)| f64::from((a - b) * (a - b)));
        (squares.sum::<f64>() / self.0.len() as f64).sqrt()
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
            (Some(a), Some(b)) => a.difference(b) < DIFFERENCE,
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
        let large = Luma { width: 32, height: 48, values: (0..32 * 48).map(|i| (i % 2) as f32).collect() };
        assert_eq!(Thumbnail::of(&large), Thumbnail(vec![0.5; SIDE * SIDE]));
        let small = Luma { width: 3, height: 1, values: vec![0.25; 3] };
        let thumbnail = Thumbnail::of(&small);
        assert_eq!(thumbnail, Thumbnail(vec![0.25; SIDE * SIDE]));
        assert!((thumbnail.difference(&Thumbnail::of(&large)) - 0.25).abs() < 1e-7);
    }
}
