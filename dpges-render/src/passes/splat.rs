//! Gaussians between the layers, summed in any order.

use super::pipeline::{ADDITIVE, Depth, Stage};
use super::{Fading, Kit, Texture};

macro_rules! shader {
    ($fade:literal) => {
        concat!(
            include_str!("frame.wgsl"),
            include_str!("ellipse.wgsl"),
            include_str!($fade),
            include_str!("splat.wgsl")
        )
    };
}

pub(crate) const fn shader(fading: Fading) -> &'static str {
    match fading {
        Fading::Whole => shader!("fade_whole.wgsl"),
        Fading::Paged => shader!("fade_paged.wgsl"),
    }
}

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
    pub fn new(kit: &Kit, sums: wgpu::TextureFormat, fading: Fading) -> Self {
        let shader = kit.shader("splat", shader(fading));
        let layout = kit.textures("splat", &fading.with_factors(&[Texture::Uint; 4]));
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
