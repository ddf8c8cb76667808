//! From layers to the surfels' picture, the intervals of Gaussians, and the depth that hides them.

use super::pipeline::{Depth, Stage};
use super::{COLOUR_FORMAT, INTERVAL_FORMAT, Kit, THIRD_FORMAT, Texture};

pub(crate) const SHADER: &str = concat!(
    include_str!("frame.wgsl"),
    include_str!("harmonics.wgsl"),
    include_str!("behind.wgsl"),
    include_str!("layer.wgsl"),
    include_str!("resolve.wgsl")
);

#[derive(Debug)]
pub(crate) struct ResolvePass {
    pub layout: wgpu::BindGroupLayout,
    pub pipeline: wgpu::RenderPipeline,
}

impl ResolvePass {
    pub fn new(kit: &Kit) -> Self {
        use Texture::{Float, Uint};
        let shader = kit.shader("resolve", SHADER);
        let layout = kit.textures("resolve", &[Float, Float, Uint, Uint, Uint, Uint, Float, Float, Float, Float]);
        let stage = Stage {
            label: "resolve",
            vertex: "vertex",
            fragment: "fragment",
            targets: &[(COLOUR_FORMAT, None), (INTERVAL_FORMAT, None), (THIRD_FORMAT, None)],
            writes: true,
            depth: Depth::Write,
            quads: false,
        };
        let pipeline = kit.pipeline(&shader, &layout, &stage);
        Self { layout, pipeline }
    }
}
