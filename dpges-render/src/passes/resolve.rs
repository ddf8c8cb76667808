//! From layers to the surfels' picture, the intervals of Gaussians, and the depth that hides them.

use super::pipeline::{Depth, Pass, Stage};
use super::{COLOUR_FORMAT, FLOAT, INTERVAL_FORMAT, Kit, THROUGH_FORMAT, UINT};
use crate::options::MAX_LAYERS;

pub(crate) const SHADER: &str = concat!(
    include_str!("frame.wgsl"),
    include_str!("harmonics.wgsl"),
    include_str!("behind.wgsl"),
    include_str!("layer.wgsl"),
    include_str!("resolve.wgsl")
);

pub(crate) fn pass(kit: &Kit) -> Pass {
    let textures = [&[FLOAT; 2][..], &[UINT; MAX_LAYERS + 1], &[FLOAT; MAX_LAYERS]].concat();
    let targets = [(COLOUR_FORMAT, None), (INTERVAL_FORMAT, None), (THROUGH_FORMAT, None)];
    kit.pass("resolve", SHADER, &textures, &Stage { depth: Depth::Write, ..Stage::over(&targets) })
}
