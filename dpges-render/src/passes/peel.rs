//! The layers: the nearest fragments of surfels, one pass each.

use super::pipeline::{ADDITIVE, Depth, Stage};
use super::{Kit, LAYER_FORMAT, OPACITY_FORMAT, Texture};

pub(crate) const SHADER: &str =
    concat!(include_str!("frame.wgsl"), include_str!("layer.wgsl"), include_str!("peel.wgsl"));

#[derive(Debug)]
pub(crate) struct PeelPass {
    pub layout: wgpu::BindGroupLayout,
    /// Nearest fragments.
    pub first: wgpu::RenderPipeline,
    /// Nearest fragments behind those of the previous layer.
    pub next: wgpu::RenderPipeline,
    /// Closes pixels that have no next layer.
    pub close: wgpu::RenderPipeline,
    /// Counts fragments into sums.
    pub count: wgpu::RenderPipeline,
}

impl PeelPass {
    pub fn new(kit: &Kit, sums: wgpu::TextureFormat) -> Self {
        let shader = kit.shader("peel", SHADER);
        let layout = kit.textures("peel", &[Texture::Float, Texture::Uint, Texture::Uint]);
        let stage = |vertex: &'static str, fragment: &'static str, writes: bool, quads: bool| Stage {
            label: "peel",
            vertex,
            fragment,
            targets: &[(LAYER_FORMAT, None), (OPACITY_FORMAT, None)],
            writes,
            depth: if quads { Depth::Nearest } else { Depth::Write },
            quads,
        };
        let pipeline = |stage: &Stage| kit.pipeline(&shader, &layout, stage);
        let targets = &[(sums, Some(ADDITIVE))];
        let counting =
            Stage { label: "count surfels", targets, depth: Depth::None, ..stage("vertex", "count", true, true) };
        Self {
            first: pipeline(&stage("vertex", "first", true, true)),
            next: pipeline(&stage("vertex", "next", true, true)),
            close: pipeline(&stage("close_vertex", "close", false, false)),
            count: pipeline(&counting),
            layout,
        }
    }
}
