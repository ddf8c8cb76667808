//! From layers to the surfels' picture, the intervals of Gaussians, and the depth that hides them.

use super::pipeline::{Depth, Pass, Stage};
use super::{COLOUR_FORMAT, FLOAT, INTERVAL_FORMAT, Kit, THIRD_FORMAT, UINT};

pub(crate) const SHADER: &str = concat!(
    include_str!("frame.wgsl"),
    include_str!("harmonics.wgsl"),
    include_str!("behind.wgsl"),
    include_str!("layer.wgsl"),
    include_str!("resolve.wgsl")
);

pub(crate) fn pass(kit: &Kit) -> Pass {
    let textures = [FLOAT, FLOAT, UINT, UINT, UINT, UINT, FLOAT, FLOAT, FLOAT, FLOAT];
    let targets = [(COLOUR_FORMAT, None), (INTERVAL_FORMAT, None), (THIRD_FORMAT, None)];
    kit.pass("resolve", SHADER, &textures, &Stage { depth: Depth::Write, ..Stage::over(&targets) })
}
