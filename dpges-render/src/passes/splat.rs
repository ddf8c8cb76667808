//! Gaussians between the layers, summed in any order.

use super::pipeline::{ADDITIVE, Depth, Stage};
use super::{Fading, Kit, UINT};

pub(crate) fn shader(fading: Fading) -> String {
    [include_str!("frame.wgsl"), include_str!("ellipse.wgsl"), fading.shader(), include_str!("splat.wgsl")].concat()
}

#[derive(Debug)]
pub(crate) struct SplatPass {
    pub layout: wgpu::BindGroupLayout,
    one_layer: wgpu::RenderPipeline,
    three_layers: wgpu::RenderPipeline,
    four_layers: wgpu::RenderPipeline,
    pub count: wgpu::RenderPipeline,
}

impl SplatPass {
    pub fn new(kit: &Kit, sums: wgpu::TextureFormat, fading: Fading) -> Self {
        let program = kit.program("splat", shader(fading), &fading.with_factors(&[UINT; 4]));
        let targets = [(sums, Some(ADDITIVE))];
        let stage = Stage { depth: Depth::Test, quads: true, ..Stage::over(&targets) };
        let pipeline = |fragment| program.pipeline(&Stage { fragment, ..stage });
        Self {
            one_layer: pipeline("one_layer"),
            three_layers: pipeline("three_layers"),
            four_layers: pipeline("four_layers"),
            count: pipeline("count"),
            layout: program.layout,
        }
    }

    pub fn of(&self, layers: usize) -> &wgpu::RenderPipeline {
        match layers {
            1 => &self.one_layer,
            2 | 3 => &self.three_layers,
            _ => &self.four_layers,
        }
    }
}
