//! Intrinsics that are probably those of another unit or of another picture.

use dpges_core::camera::Camera;

use super::source::Source;
use crate::error::{DatasetError, Result};
use crate::finding::Kind;

/// A principal point in 0..1 is normalised in pictures of more px, both ways.
const MORE_THAN_A_FEW_PX: usize = 8;
/// Shorter focal lengths are normalised, or no lens has them, in pictures of [`LARGE_PX`], px.
const NO_FOCAL_PX: f64 = 4.0;
/// Shorter ones are said, px.
const SHORT_FOCAL_PX: f64 = 10.0;
/// Longer side of a picture from which focal lengths are judged, px.
const LARGE_PX: usize = 100;

/// Refuses normalised intrinsics, and principal points outside of pictures of which only the files of pictures know the size; says
/// which others are rare.
///
/// # Errors
/// [`DatasetError::Malformed`].
pub(crate) fn check(source: &mut Source) -> Result<()> {
    let (mut outside, mut short) = (Vec::new(), Vec::new());
    for frame in source.frames.iter().filter(|frame| frame.panorama.is_none()) {
        let Camera { fx, fy, cx, cy, width, height, .. } = frame.camera;
        let refused = |what: &str, found: String, expected: &str| {
            let (what, found) = (
                format!("the {what} of view `{}`", frame.name),
                format!("{found} in a picture of {width}x{height} px"),
            );
            Err(DatasetError::malformed(&frame.described_in, what, found, expected))
        };
        let (longer, shorter, focal) = (width.max(height), width.min(height), fx.max(fy));
        if shorter > MORE_THAN_A_FEW_PX && [cx, cy].iter().all(|at| (0.0..=1.0).contains(at)) {
            return refused("principal point", format!("{cx}, {cy}"), "a position in px (is it normalised?)");
        }
        if longer >= LARGE_PX && (0.0..NO_FOCAL_PX).contains(&focal) {
            return refused("focal length", format!("{focal}"), "a length in px (is it normalised?)");
        }
        let is_outside = [(cx, width), (cy, height)].iter().any(|&(at, side)| at < 0.0 || at > side as f64);
        if is_outside && !frame.is_sized {
            let expected = "one within it; if it is that of another size, give that as `w` and `h`";
            return refused("principal point", format!("{cx}, {cy}"), expected);
        }
        outside.extend(is_outside.then_some(&frame.name));
        let is_short = longer >= LARGE_PX && (0.0..SHORT_FOCAL_PX).contains(&fx.min(fy));
        short.extend(is_short.then_some(&frame.name));
    }
    let advice = "look whether the intrinsics are those of these pictures";
    let what = "views have a principal point outside of their picture";
    source.notices.add_names(Kind::Intrinsics, what, &outside, advice);
    let what = "views have a focal length of a few px";
    source.notices.add_names(Kind::Intrinsics, what, &short, advice);
    Ok(())
}
