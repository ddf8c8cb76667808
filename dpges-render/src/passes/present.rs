//! From sums to the picture.

use super::pipeline::Stage;
use super::{FLOAT, Kit, UINT};
use crate::options::MAX_LAYERS;

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
        let program = kit.program("present", SHADER, &[&[FLOAT; 3][..], &[UINT; MAX_LAYERS + 2]].concat());
        let pipeline = |fragment| program.pipeline(&Stage { fragment, ..Stage::over(&[(format, None)]) });
        Self {
            image: pipeline("image"),
            peeled: pipeline("fragment"),
            blended: pipeline("blended"),
            layout: program.layout,
        }
    }
}
