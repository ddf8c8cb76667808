//! The layers: the nearest fragments of surfels, one pass each. With a backstop, a pass before them finds the cores, which
//! are the nearest opaque fragments.

use super::pipeline::{ADDITIVE, Depth, Stage};
use super::{Fading, Kit, LAYER_FORMAT, OPACITY_FORMAT, Texture};
use crate::options::{DepthSource, RenderOptions};

macro_rules! shader {
    ($depth:literal, $fade:literal) => {
        concat!(
            include_str!("frame.wgsl"),
            include_str!("layer.wgsl"),
            include_str!($depth),
            include_str!($fade),
            include_str!("peel.wgsl")
        )
    };
}

pub(crate) const fn shader(depths: DepthSource, fading: Fading) -> &'static str {
    match (depths, fading) {
        (DepthSource::Rasterised, Fading::Whole) => shader!("depth_rasterised.wgsl", "fade_whole.wgsl"),
        (DepthSource::Rasterised, Fading::Paged) => shader!("depth_rasterised.wgsl", "fade_paged.wgsl"),
        (DepthSource::Computed, Fading::Whole) => shader!("depth_computed.wgsl", "fade_whole.wgsl"),
        (DepthSource::Computed, Fading::Paged) => shader!("depth_computed.wgsl", "fade_paged.wgsl"),
    }
}

#[derive(Debug)]
pub(crate) struct PeelPass {
    pub layout: wgpu::BindGroupLayout,
    /// Nearest opaque fragments.
    pub core: wgpu::RenderPipeline,
    /// Nearest fragments, of all or of those before the core: in the first layer, and behind the previous one.
    first: [wgpu::RenderPipeline; 2],
    next: [wgpu::RenderPipeline; 2],
    /// Closes pixels that have no next layer.
    close: wgpu::RenderPipeline,
    /// Starts a layer with the cores, and closes pixels that have no such layer; in the last, closes those with a core.
    start_first: [wgpu::RenderPipeline; 2],
    start_next: [wgpu::RenderPipeline; 2],
    /// Counts fragments into sums.
    pub count: wgpu::RenderPipeline,
}

impl PeelPass {
    pub fn new(kit: &Kit, sums: wgpu::TextureFormat, depths: DepthSource, fading: Fading) -> Self {
        let shader = kit.shader("peel", shader(depths, fading));
        let textures = [Texture::Float, Texture::Uint, Texture::Uint, Texture::Uint];
        let layout = kit.textures("peel", &fading.with_factors(&textures));
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
        let core =
            Stage { label: "cores", targets: &[(LAYER_FORMAT, None)], ..stage("core_vertex", "core", true, true) };
        let quads = |fragment| pipeline(&stage("vertex", fragment, true, true));
        let start =
            |fragment| ["open_vertex", "close_vertex"].map(|vertex| pipeline(&stage(vertex, fragment, true, false)));
        Self {
            core: pipeline(&core),
            first: ["first", "first_before_core"].map(quads),
            next: ["next", "next_before_core"].map(quads),
            close: pipeline(&stage("close_vertex", "close", false, false)),
            start_first: start("start_first"),
            start_next: start("start_next"),
            count: pipeline(&counting),
            layout,
        }
    }

    /// The pipeline that draws over the whole picture before the surfels of layer `k`, if any, and the pipeline of
    /// these surfels. In the last layer, surfels come only where there is no core.
    pub fn of(&self, k: usize, options: &RenderOptions) -> (Option<&wgpu::RenderPipeline>, &wgpu::RenderPipeline) {
        let is_last = k + 1 == options.layer_count;
        let before = match (options.backstop, k) {
            (false, 0) => None,
            (false, _) => Some(&self.close),
            (true, 0) => Some(&self.start_first[usize::from(is_last)]),
            (true, _) => Some(&self.start_next[usize::from(is_last)]),
        };
        let pipelines = if k == 0 { &self.first } else { &self.next };
        (before, &pipelines[usize::from(options.backstop && !is_last)])
    }
}
