//! Scenes of blended Gaussians or discs: back to front, in an order that the host finds.

use super::pipeline::{ADDITIVE, Stage};
use super::{FLOAT, Kit, UINT};

pub(crate) const SHADER: &str =
    concat!(include_str!("frame.wgsl"), include_str!("ellipse.wgsl"), include_str!("sorted.wgsl"));

#[derive(Debug)]
pub(crate) struct SortedPass {
    pub layout: wgpu::BindGroupLayout,
    pub ellipses: wgpu::RenderPipeline,
    pub discs: wgpu::RenderPipeline,
    pub count_ellipses: wgpu::RenderPipeline,
    pub count_discs: wgpu::RenderPipeline,
}

impl SortedPass {
    pub fn new(kit: &Kit, sums: wgpu::TextureFormat) -> Self {
        let program = kit.program("sorted", SHADER, &[UINT, UINT, UINT, FLOAT, UINT, FLOAT]);
        let over = wgpu::BlendState::PREMULTIPLIED_ALPHA_BLENDING;
        let pipeline = |vertex, fragment, blend| {
            program.pipeline(&Stage { vertex, fragment, quads: true, ..Stage::over(&[(sums, Some(blend))]) })
        };
        Self {
            ellipses: pipeline("ellipse_vertex", "ellipse", over),
            discs: pipeline("disc_vertex", "disc", over),
            count_ellipses: pipeline("ellipse_vertex", "count_ellipse", ADDITIVE),
            count_discs: pipeline("disc_vertex", "count_disc", ADDITIVE),
            layout: program.layout,
        }
    }
}
