//! The colour of every surfel, or disc, from the camera: once per frame, not per fragment.

use super::pipeline::{Depth, Stage};
use super::{COLOUR_FORMAT, Kit, Texture};

pub(crate) const SHADER: &str = concat!(
    include_str!("frame.wgsl"),
    include_str!("harmonics.wgsl"),
    include_str!("colour.wgsl"),
    include_str!("colours.wgsl")
);

#[derive(Debug)]
pub(crate) struct ColoursPass {
    pub layout: wgpu::BindGroupLayout,
    pub pipeline: wgpu::RenderPipeline,
}

impl ColoursPass {
    pub fn new(kit: &Kit) -> Self {
        let shader = kit.shader("colours", SHADER);
        let layout = kit.textures("colours", &[Texture::Float, Texture::Uint]);
        let stage = Stage {
            label: "colours",
            vertex: "vertex",
            fragment: "fragment",
            targets: &[(COLOUR_FORMAT, None)],
            writes: true,
            depth: Depth::None,
            quads: false,
        };
        let pipeline = kit.pipeline(&shader, &layout, &stage);
        Self { layout, pipeline }
    }
}
