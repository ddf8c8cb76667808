//! The layers: the nearest fragments of surfels, one pass each. With continuous peeling, a pass before them finds the cores,
//! which are the nearest opaque fragments, and the others are peeled beside them.

use super::pipeline::{ADDITIVE, Depth, Stage};
use super::{FLOAT, Fading, Kit, LAYER_FORMAT, OPACITY_FORMAT, UINT};
use crate::options::{DepthSource, RenderOptions};

pub(crate) fn shader(depths: DepthSource, fading: Fading) -> String {
    let depth = match depths {
        DepthSource::Rasterised => include_str!("depth_rasterised.wgsl"),
        DepthSource::Computed => include_str!("depth_computed.wgsl"),
    };
    [include_str!("frame.wgsl"), include_str!("layer.wgsl"), depth, fading.shader(), include_str!("peel.wgsl")].concat()
}

#[derive(Debug)]
pub(crate) struct PeelPass {
    pub layout: wgpu::BindGroupLayout,
    pub core: wgpu::RenderPipeline,
    /// Nearest fragments, of all or of those that are not the core: in the first layer, and behind the previous one.
    first: [wgpu::RenderPipeline; 2],
    next: [wgpu::RenderPipeline; 2],
    /// Closes pixels that have no next layer; beside cores, also ends those that have one behind the core.
    close: wgpu::RenderPipeline,
    start_first: wgpu::RenderPipeline,
    start_next: wgpu::RenderPipeline,
    pub count: wgpu::RenderPipeline,
}

impl PeelPass {
    pub fn new(kit: &Kit, sums: wgpu::TextureFormat, depths: DepthSource, fading: Fading) -> Self {
        let textures = [FLOAT, UINT, UINT, UINT];
        let program = kit.program("peel", shader(depths, fading), &fading.with_factors(&textures));
        let (layer, sums) = ([(LAYER_FORMAT, None), (OPACITY_FORMAT, None)], [(sums, Some(ADDITIVE))]);
        let whole = Stage { depth: Depth::Write, ..Stage::over(&layer) };
        let surfels = Stage { depth: Depth::Nearest, quads: true, ..whole };
        let quads = |fragment| program.pipeline(&Stage { fragment, ..surfels });
        let start = |fragment| program.pipeline(&Stage { vertex: "open_vertex", fragment, writes: false, ..whole });
        let core = Stage { vertex: "core_vertex", fragment: "core", targets: &layer[..1], ..surfels };
        let close = Stage { vertex: "close_vertex", fragment: "close", writes: false, ..whole };
        let count = Stage { fragment: "count", quads: true, ..Stage::over(&sums) };
        Self {
            core: program.pipeline(&core),
            first: ["first", "first_other"].map(quads),
            next: ["next", "next_other"].map(quads),
            close: program.pipeline(&close),
            start_first: start("start_first"),
            start_next: start("start_next"),
            count: program.pipeline(&count),
            layout: program.layout,
        }
    }

    /// The pipeline that draws over the whole picture before the surfels of layer `k`, if any, and the pipeline of
    /// these surfels.
    pub fn of(&self, k: usize, options: &RenderOptions) -> (Option<&wgpu::RenderPipeline>, &wgpu::RenderPipeline) {
        let continuous = options.peeling.is_continuous();
        let before = match (continuous, k) {
            (false, 0) => None,
            (false, _) => Some(&self.close),
            (true, 0) => Some(&self.start_first),
            (true, _) => Some(&self.start_next),
        };
        let pipelines = if k == 0 { &self.first } else { &self.next };
        (before, &pipelines[usize::from(continuous)])
    }
}
