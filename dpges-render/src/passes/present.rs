//! From sums to the picture.

use super::pipeline::{Depth, Stage};
use super::{Kit, Texture};

pub(crate) const SHADER: &str = concat!(
    include_str!("frame.wgsl"),
    include_str!("harmonics.wgsl"),
    include_str!("behind.wgsl"),
    include_str!("layer.wgsl"),
    include_str!("present.wgsl")
);

#[derive(Debug)]
pub(crate) struct PresentPass {
    pub layout: wgpu::BindGroupLayout,
    /// The picture alone.
    pub image: wgpu::RenderPipeline,
    /// Any display.
    pub peeled: wgpu::RenderPipeline,
    pub blended: wgpu::RenderPipeline,
}

impl PresentPass {
    pub fn new(kit: &Kit, format: wgpu::TextureFormat) -> Self {
        use Texture::{Float, Uint};
        let shader = kit.shader("present", SHADER);
        let layout = kit.textures("present", &[Float, Float, Float, Uint, Uint, Uint, Uint, Uint]);
        let pipeline = |fragment| {
            let targets = &[(format, None)];
            let stage = Stage {
                label: "present",
                vertex: "vertex",
                fragment,
                targets,
                writes: true,
                depth: Depth::None,
                quads: false,
            };
            kit.pipeline(&shader, &layout, &stage)
        };
        Self { image: pipeline("image"), peeled: pipeline("fragment"), blended: pipeline("blended"), layout }
    }
}
