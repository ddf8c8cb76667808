//! Gaussians between the layers, summed in any order.

use super::pipeline::{ADDITIVE, Depth, Stage};
use super::{Kit, Texture};

pub(crate) const SHADER: &str =
    concat!(include_str!("frame.wgsl"), include_str!("ellipse.wgsl"), include_str!("splat.wgsl"));

#[derive(Debug)]
pub(crate) struct SplatPass {
    pub layout: wgpu::BindGroupLayout,
    one_layer: wgpu::RenderPipeline,
    three_layers: wgpu::RenderPipeline,
    four_layers: wgpu::RenderPipeline,
    /// Counts fragments.
    pub count: wgpu::RenderPipeline,
}

impl SplatPass {
    pub fn new(kit: &Kit, sums: wgpu::TextureFormat) -> Self {
        let shader = kit.shader("splat", SHADER);
        let layout = kit.textures("splat", &[Texture::Uint; 4]);
        let pipeline = |fragment| {
            let stage = Stage {
                label: "splat",
                vertex: "vertex",
                fragment,
                targets: &[(sums, Some(ADDITIVE))],
                writes: true,
                depth: Depth::Test,
                quads: true,
            };
            kit.pipeline(&shader, &layout, &stage)
        };
        Self {
            one_layer: pipeline("one_layer"),
            three_layers: pipeline("three_layers"),
            four_layers: pipeline("four_layers"),
            count: pipeline("count"),
            layout,
        }
    }

    /// The pipeline for K = `layers`.
    pub fn of(&self, layers: usize) -> &wgpu::RenderPipeline {
        match layers {
            1 => &self.one_layer,
            2 | 3 => &self.three_layers,
            _ => &self.four_layers,
        }
    }
}
