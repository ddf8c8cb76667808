//! Blurred photographs. A blur, whether of the focus or of a movement, takes the finest detail away first, in some direction
//! at least, and the ratio of detail of one pixel to detail of two hardly depends on what a picture shows.

use super::finding::{Finding, Kind};
use super::view::ViewFacts;

/// Relative to the median of the views: the ratio below which, together with that much detail or less, a photograph is
/// blurred. A blur of one pixel gives 0.15 to 0.4 and 0.03 to 0.15; sharp photographs have more than 0.6 or 0.5.
const FINENESS: f64 = 0.6;
const DETAIL: f64 = 0.35;

/// The photographs that are blurred, from the worst.
pub(super) fn blurred(views: &[ViewFacts]) -> Option<Finding> {
    let ratio = |view: &ViewFacts| view.sharpness.unwrap_or(1.0);
    let mut blurred: Vec<&ViewFacts> = views
        .iter()
        .filter(|view| ratio(view) < FINENESS && view.detail.is_some_and(|detail| detail < DETAIL))
        .collect();
    blurred.sort_by(|a, b| ratio(a).total_cmp(&ratio(b)));
    Finding::of_views(
        Kind::Blurred,
        &blurred,
        ["a photograph is blurred", "photographs are blurred"],
        |view| format!(" ({:.0} % of the usual sharpness)", 100.0 * ratio(view)),
        "leave them out, or train on smaller pictures (--max-resolution)",
    )
}
