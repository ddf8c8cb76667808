//! Photographs of different brightness. A difference counts if views show the same points in different brightness, not if
//! one shows a window and another a corner.

use dpges_core::camera::Camera;
use glam::DVec3;

use super::finding::{Finding, Kind};
use super::statistics::{Range, deviation};
use super::view::ViewFacts;
use crate::dataset::{Picture, PointCloud};

/// Difference from the median that is named: at least, stops, and in standard deviations of the views.
const LEAST: f64 = 0.5;
const DEVIATIONS: f64 = 4.0;
/// Range from the 5th to the 95th percentile that is named, stops.
const SPREAD: f64 = 1.0;
/// Points of a view that are compared: at least, at most.
const FEWEST_POINTS: usize = 20;
const MOST_POINTS: usize = 2000;
/// Values that may be clipped, and luminances that are little more than noise.
const CLIPPED: f32 = 0.98;
const DARK: f64 = 0.005;

/// How much brighter the picture shows the points that it saw, where it counts, than they are on average, stops. `None` if they
/// are few.
pub(super) fn of_view(camera: &Camera, picture: &Picture, points: &PointCloud, seen: &[u32]) -> Option<f64> {
    let step = seen.len().div_ceil(MOST_POINTS).max(1);
    let stops = seen.iter().step_by(step).filter_map(|&point| {
        let (position, colour) = (points.positions[point as usize], points.colours[point as usize]);
        let (pixel, _) = camera.pixel(DVec3::from_array(position.map(f64::from)))?;
        if !picture.counts(pixel) {
            return None;
        }
        let shown = picture.rgb(pixel % camera.width, pixel / camera.width);
        if shown.iter().chain(&colour).any(|&value| value > CLIPPED) {
            return None;
        }
        let [shown, usual] = [shown, colour].map(luminance);
        (shown > DARK && usual > DARK).then(|| (shown / usual).log2())
    });
    let stops: Vec<f64> = stops.collect();
    if stops.len() < FEWEST_POINTS { None } else { super::statistics::median(stops) }
}

/// Luminance of an sRGB colour, 0 to 1.
fn luminance(rgb: [f32; 3]) -> f64 {
    let linear = |value: f32| {
        let value = f64::from(value);
        if value <= 0.04045 { value / 12.92 } else { ((value + 0.055) / 1.055).powf(2.4) }
    };
    let [r, g, b] = rgb.map(linear);
    0.2126 * r + 0.7152 * g + 0.0722 * b
}

/// The views that are brighter or darker than most, from the most different.
pub(super) fn different(views: &[ViewFacts]) -> Option<Finding> {
    let all = || views.iter().filter_map(|view| view.exposure);
    let limit = LEAST.max(DEVIATIONS * deviation(all(), 0.0));
    let stops = |view: &ViewFacts| view.exposure.unwrap_or(0.0);
    let mut different: Vec<&ViewFacts> = views.iter().filter(|view| stops(view).abs() > limit).collect();
    different.sort_by(|a, b| stops(b).abs().total_cmp(&stops(a).abs()));
    Finding::of_views(
        Kind::Exposure,
        &different,
        ["a photograph is brighter or darker than the rest", "photographs are brighter or darker than the rest"],
        |view| format!(" ({:+.1} stops)", stops(view)),
        "have it corrected while training (train.exposure=on), or leave them out: views that disagree make haze",
    )
}

/// Whether views differ throughout.
pub(super) fn spread(views: &[ViewFacts]) -> Option<Finding> {
    let Range { low, high, .. } = Range::of(views.iter().filter_map(|view| view.exposure))?;
    (high - low > SPREAD).then(|| Finding {
        kind: Kind::ExposureSpread,
        views: Vec::new(),
        message: format!(
            "the photographs differ in brightness by {:.1} stops, between {low:+.1} and {high:+.1}",
            high - low
        ),
        advice: "have it corrected while training (train.exposure=on), or photograph with one exposure and one white balance",
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn luminance_is_linear_and_weighted() {
        assert!((luminance([1.0; 3]) - 1.0).abs() < 1e-12 && luminance([0.0; 3]) == 0.0);
        assert!((luminance([0.5, 0.5, 0.5]) - 0.214).abs() < 1e-3);
        assert!(luminance([0.0, 0.5, 0.0]) > luminance([0.5, 0.0, 0.5]));
    }
}
