//! Scenes of blended Gaussians or discs: back to front, in an order that the host finds.

use super::pipeline::{ADDITIVE, Depth, Stage};
use super::{Kit, Texture};

pub(crate) const SHADER: &str =
    concat!(include_str!("frame.wgsl"), include_str!("ellipse.wgsl"), include_str!("sorted.wgsl"));

#[derive(Debug)]
pub(crate) struct SortedPass {
    pub layout: wgpu::BindGroupLayout,
    pub ellipses: wgpu::RenderPipeline,
    pub discs: wgpu::RenderPipeline,
    /// Count fragments.
    pub count_ellipses: wgpu::RenderPipeline,
    pub count_discs: wgpu::RenderPipeline,
}

impl SortedPass {
    pub fn new(kit: &Kit, sums: wgpu::TextureFormat) -> Self {
        use Texture::{Float, Uint};
        let shader = kit.shader("sorted", SHADER);
        let layout = kit.textures("sorted", &[Uint, Uint, Uint, Float, Uint, Float]);
        let over = wgpu::BlendState::PREMULTIPLIED_ALPHA_BLENDING;
        let pipeline = |vertex, fragment, blend| {
            let targets = &[(sums, Some(blend))];
            let stage =
                Stage { label: "sorted", vertex, fragment, targets, writes: true, depth: Depth::None, quads: true };
            kit.pipeline(&shader, &layout, &stage)
        };
        Self {
            ellipses: pipeline("ellipse_vertex", "ellipse", over),
            discs: pipeline("disc_vertex", "disc", over),
            count_ellipses: pipeline("ellipse_vertex", "count_ellipse", ADDITIVE),
            count_discs: pipeline("disc_vertex", "count_disc", ADDITIVE),
            layout,
        }
    }
}
