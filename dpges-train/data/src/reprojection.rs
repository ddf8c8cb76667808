//! Whether cameras stand where the points that they saw say they do.

use super::View;
use super::finding::{Finding, Kind, Notices};
use super::formats::source::{Source, Split};
use super::names::list_up_to;

/// Distance of points from where a photograph shows them that is named, px and times that of most views. Structure from motion
/// leaves less than a pixel.
const OFF_PX: f64 = 2.0;
const OFF_TIMES: f64 = 4.0;
/// A larger distance in most views, as a share of the width, says that keypoints are those of pictures of another size.
const ANOTHER_SIZE: f64 = 0.05;
/// Names in the message before the rest is counted.
const NAMED: usize = 5;

/// The median over the training views, px of their photographs as they are trained on; `None` if it is unknown. Adds the views
/// that are further off than most to `notices`.
pub(super) fn judge(source: &Source, train: &[View], notices: &mut Notices) -> Option<f64> {
    let frames = source.frames.iter().zip(&source.reprojection_px).filter(|(frame, _)| frame.split == Split::Train);
    let errors = frames.zip(train).filter_map(|((frame, error_px), view)| {
        Some((view, (*error_px)? * view.camera.width as f64 / frame.camera.width as f64))
    });
    let mut errors: Vec<(&View, f64)> = errors.collect();
    errors.sort_by(|(_, a), (_, b)| b.total_cmp(a));
    let &(middle, median) = errors.get(errors.len() / 2)?;
    if median > ANOTHER_SIZE * middle.camera.width as f64 {
        return None;
    }
    let off = errors.iter().take_while(|(_, error)| *error > OFF_PX.max(OFF_TIMES * median));
    let (views, named): (Vec<String>, Vec<String>) =
        off.map(|(view, error)| (view.name.clone(), format!("{} ({error:.1} px)", view.name))).unzip();
    if !views.is_empty() {
        let message = format!(
            "cameras are not where the points that they saw say, which others miss by {median:.1} px ({}): {}",
            views.len(),
            list_up_to(NAMED, &named)
        );
        let advice = "find them again, leave them out, or have them corrected while training (train.poses=on)";
        notices.0.push(Finding { kind: Kind::OffPose, views, message, advice });
    }
    Some(median)
}
