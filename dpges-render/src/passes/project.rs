//! The ellipse that every Gaussian projects to, and its colour: once per frame.

use super::pipeline::{Depth, Stage};
use super::{Kit, RECORD_FORMAT, Texture};

pub(crate) const SHADER: &str = concat!(
    include_str!("frame.wgsl"),
    include_str!("harmonics.wgsl"),
    include_str!("colour.wgsl"),
    include_str!("project.wgsl")
);

#[derive(Debug)]
pub(crate) struct ProjectPass {
    pub layout: wgpu::BindGroupLayout,
    pub pipeline: wgpu::RenderPipeline,
}

impl ProjectPass {
    pub fn new(kit: &Kit) -> Self {
        let shader = kit.shader("project", SHADER);
        let layout = kit.textures("project", &[Texture::Float, Texture::Uint, Texture::Uint]);
        let stage = Stage {
            label: "project",
            vertex: "vertex",
            fragment: "fragment",
            targets: &[(RECORD_FORMAT, None); 2],
            writes: true,
            depth: Depth::None,
            quads: false,
        };
        let pipeline = kit.pipeline(&shader, &layout, &stage);
        Self { layout, pipeline }
    }
}
