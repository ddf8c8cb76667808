//! Cameras that are far from all others: structure from motion has probably put them in the wrong place.

use glam::DVec3;

use super::finding::{Finding, Kind};
use super::statistics::median;
use super::view::ViewFacts;

/// Distances, relative to the spread of the cameras, beyond which a camera is far: from their middle, and from the next.
const FROM_THE_MIDDLE: f64 = 5.0;
const FROM_THE_NEXT: f64 = 2.0;

/// The middle of the cameras: of each coordinate the median.
pub(super) fn middle(views: &[ViewFacts]) -> DVec3 {
    let centres: Vec<DVec3> = views.iter().map(|view| view.camera.centre()).collect();
    DVec3::from_array([0, 1, 2].map(|axis| median(centres.iter().map(|centre| centre[axis])).unwrap_or(0.0)))
}

/// The median distance of a camera from their middle, world units.
pub(super) fn spread(views: &[ViewFacts]) -> f64 {
    let middle = middle(views);
    median(views.iter().map(|view| view.camera.centre().distance(middle))).unwrap_or(0.0)
}

/// The views that are far from the rest, from the farthest.
pub(super) fn far(views: &[ViewFacts]) -> Option<Finding> {
    let (middle, spread) = (middle(views), spread(views));
    let distance = |view: &ViewFacts| view.camera.centre().distance(middle) / spread;
    let next = |view: &ViewFacts| {
        let others = views.iter().filter(|other| !std::ptr::eq(*other, view));
        others.map(|other| other.camera.centre().distance(view.camera.centre()) / spread).fold(f64::INFINITY, f64::min)
    };
    let is_far = |view: &&ViewFacts| distance(view) > FROM_THE_MIDDLE && next(view) > FROM_THE_NEXT;
    let mut far: Vec<&ViewFacts> = views.iter().filter(|_| spread > 0.0).filter(is_far).collect();
    far.sort_by(|a, b| distance(b).total_cmp(&distance(a)));
    Finding::of_views(
        Kind::FarPose,
        &far,
        ["a camera is far from all others", "cameras are far from all others"],
        |view| format!(" ({:.0} times as far from the middle as usual)", distance(view)),
        "their places are probably wrong: leave them out, or find the cameras again",
    )
}
