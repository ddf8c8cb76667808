//! The ellipse that every Gaussian projects to, and its colour: once per frame.

use super::pipeline::{Pass, Stage};
use super::{FLOAT, Kit, RECORD_FORMAT, UINT};

pub(crate) const SHADER: &str = concat!(
    include_str!("frame.wgsl"),
    include_str!("harmonics.wgsl"),
    include_str!("colour.wgsl"),
    include_str!("project.wgsl")
);

pub(crate) fn pass(kit: &Kit) -> Pass {
    let textures = [FLOAT, UINT, UINT];
    kit.pass("project", SHADER, &textures, &Stage::over(&[(RECORD_FORMAT, None); 2]))
}
