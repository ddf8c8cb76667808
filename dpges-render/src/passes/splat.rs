//! Gaussians between the layers, summed in any order.

use super::pipeline::{ADDITIVE, Depth, Stage};
use super::{Fading, Kit, UINT};
use crate::options::RenderOptions;

pub(crate) fn shader(fading: Fading) -> String {
    [include_str!("frame.wgsl"), include_str!("ellipse.wgsl"), fading.shader(), include_str!("splat.wgsl")].concat()
}

#[derive(Debug)]
pub(crate) struct SplatPass {
    pub layout: wgpu::BindGroupLayout,
    one_layer: wgpu::RenderPipeline,
    faded: wgpu::RenderPipeline,
    stepped: wgpu::RenderPipeline,
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
            faded: pipeline("faded"),
            stepped: pipeline("stepped"),
            count: pipeline("count"),
            layout: program.layout,
        }
    }

    /// One layer of strict order hides by the depth test alone.
    pub fn of(&self, options: &RenderOptions) -> &wgpu::RenderPipeline {
        match options.layer_count {
            _ if options.peeling.is_continuous() => &self.faded,
            1 => &self.one_layer,
            _ => &self.stepped,
        }
    }
}
