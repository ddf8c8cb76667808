//! The colour of every surfel, or disc, from the camera: once per frame, not per fragment.

use super::pipeline::{Pass, Stage};
use super::{COLOUR_FORMAT, FLOAT, Kit, UINT};

pub(crate) const SHADER: &str = concat!(
    include_str!("frame.wgsl"),
    include_str!("harmonics.wgsl"),
    include_str!("colour.wgsl"),
    include_str!("colours.wgsl")
);

pub(crate) fn pass(kit: &Kit) -> Pass {
    kit.pass("colours", SHADER, &[FLOAT, UINT], &Stage::over(&[(COLOUR_FORMAT, None)]))
}
