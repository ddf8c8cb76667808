//! Checks of views by the points of structure from motion: without points a pose is not to be trusted, and surfaces
//! without points must be found by training alone.

use dpges_core::camera::Camera;
use glam::DVec3;

use super::finding::{Finding, Kind};
use super::statistics::median;
use super::view::{Role, ViewFacts};
use crate::dataset::{Dataset, Picture};

/// Squares along the longer side of a picture.
const SQUARES: usize = 12;
/// Points below which a view has few: of all views, and relative to the median of the set.
const FEW: usize = 20;
const FEW_OF_MEDIAN: f64 = 0.03;
/// Mean share of pictures without points that is named.
const UNEXPLAINED: f64 = 0.5;

/// A picture in squares.
pub(super) struct Cells {
    columns: usize,
    rows: usize,
    /// Whether a square counts: whether at least half its pixels do.
    counted: Vec<bool>,
}

impl Cells {
    /// Without a `picture` all squares count.
    pub fn of(camera: &Camera, picture: Option<&Picture>) -> Self {
        let longer = camera.width.max(camera.height);
        let along = |length: usize| ((SQUARES * length) as f64 / longer as f64).round().max(1.0) as usize;
        let (columns, rows) = (along(camera.width), along(camera.height));
        let mut cells = Self { columns, rows, counted: vec![true; columns * rows] };
        if let Some(counted) = picture.and_then(|picture| picture.counted.as_ref()) {
            let mut surplus = vec![0i64; columns * rows];
            for (pixel, &counts) in counted.iter().enumerate() {
                surplus[cells.square(camera, pixel)] += if counts { 1 } else { -1 };
            }
            cells.counted = surplus.into_iter().map(|surplus| surplus >= 0).collect();
        }
        cells
    }

    fn square(&self, camera: &Camera, pixel: usize) -> usize {
        let (x, y) = (pixel % camera.width, pixel / camera.width);
        y * self.rows / camera.height * self.columns + x * self.columns / camera.width
    }

    /// Share of the squares that count in which there is one of `positions`, in world units; `None` if no square counts.
    pub fn share_with(&self, camera: &Camera, positions: impl Iterator<Item = DVec3>) -> Option<f64> {
        let mut has_point = vec![false; self.counted.len()];
        for (pixel, _) in positions.filter_map(|position| camera.pixel(position)) {
            has_point[self.square(camera, pixel)] = true;
        }
        let with_point = has_point.iter().zip(&self.counted).filter(|&(&has, &counts)| has && counts).count();
        let all = self.counted.iter().filter(|&&counts| counts).count();
        (all > 0).then(|| with_point as f64 / all as f64)
    }
}

/// For each training view the indices of the points that it saw; empty if the dataset does not say.
pub(super) fn seen_by_view(dataset: &Dataset) -> Vec<Vec<u32>> {
    if dataset.points.seen_by.iter().all(Vec::is_empty) {
        return Vec::new();
    }
    let mut seen = vec![Vec::new(); dataset.train.len()];
    for (point, views) in (0..).zip(&dataset.points.seen_by) {
        views.iter().for_each(|&view| seen[view as usize].push(point));
    }
    seen
}

fn sees_nothing(view: &ViewFacts) -> bool {
    view.points_seen == Some(0) || view.unexplained == Some(1.0)
}

/// The views that see no point.
pub(super) fn unseen(views: &[ViewFacts]) -> Option<Finding> {
    let unseen: Vec<&ViewFacts> = views.iter().filter(|view| sees_nothing(view)).collect();
    Finding::of_views(
        Kind::NoPoints,
        &unseen,
        ["a view sees no point", "views see no points"],
        |_| String::new(),
        "nothing says that their cameras are in the right place: leave them out",
    )
}

/// The views that see far fewer points than others, from the fewest.
pub(super) fn few(views: &[ViewFacts]) -> Option<Finding> {
    let count = |view: &ViewFacts| view.points_seen.unwrap_or(usize::MAX);
    let usual = median(views.iter().filter_map(|view| view.points_seen).map(|count| count as f64))?;
    let limit = (FEW_OF_MEDIAN * usual).max(FEW as f64);
    let mut few: Vec<&ViewFacts> =
        views.iter().filter(|view| !sees_nothing(view) && (count(view) as f64) < limit).collect();
    few.sort_by_key(|view| count(view));
    Finding::of_views(
        Kind::FewPoints,
        &few,
        ["a view sees few points", "views see few points"],
        |view| format!(" ({})", count(view)),
        "their cameras may be slightly off; photographs with more in common with others place them better",
    )
}

/// Whether much of the pictures shows nothing that has points.
pub(super) fn unexplained(views: &[ViewFacts]) -> Option<Finding> {
    let shares: Vec<f64> =
        views.iter().filter(|view| view.role == Role::Train).filter_map(|view| view.unexplained).collect();
    let mean = shares.iter().sum::<f64>() / shares.len().max(1) as f64;
    (mean > UNEXPLAINED).then(|| Finding {
        kind: Kind::Unexplained,
        views: Vec::new(),
        message: format!("{:.0} % of what the pictures show has no points", 100.0 * mean),
        advice: "sky is no problem; walls, water and glass without texture are: expect floating surfaces there",
    })
}
