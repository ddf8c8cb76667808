//! The textures that a picture of one size goes through.

use wgpu::TextureUsages as Usage;

use crate::options::MAX_LAYERS;
use crate::passes::{
    COLOUR_FORMAT, DEPTH_FORMAT, INTERVAL_FORMAT, LAYER_FORMAT, OPACITY_FORMAT, RECORD_FORMAT, THROUGH_FORMAT,
};
use crate::scene::{Grid, SceneTextures};
use crate::texture::{size, texture};

#[derive(Debug)]
pub(crate) struct Layer {
    pub nearest: wgpu::TextureView,
    pub opacity: wgpu::TextureView,
}

#[derive(Debug)]
pub(crate) struct Targets {
    pub size: wgpu::Extent3d,
    pub layers: Vec<Layer>,
    /// The nearest opaque fragment of every pixel, as a layer.
    pub cores: wgpu::TextureView,
    pub depth: wgpu::TextureView,
    pub surfels: wgpu::TextureView,
    pub intervals: wgpu::TextureView,
    pub throughs: wgpu::TextureView,
    pub sums: wgpu::TextureView,
}

#[derive(Debug)]
pub(crate) struct PerPrimitive {
    /// Colours of surfels, or of discs.
    pub colours: wgpu::TextureView,
    pub firsts: wgpu::TextureView,
    pub seconds: wgpu::TextureView,
}

/// Textures that some passes draw into and others read.
const DRAWN_AND_READ: Usage = Usage::RENDER_ATTACHMENT.union(Usage::TEXTURE_BINDING);

impl Targets {
    pub fn new(device: &wgpu::Device, width: u32, height: u32, sums: wgpu::TextureFormat) -> Self {
        let size = size(width, height);
        let full = |format| texture(device, size, format, DRAWN_AND_READ);
        let layer = |_| Layer {
            nearest: texture(device, size, LAYER_FORMAT, DRAWN_AND_READ | Usage::COPY_SRC),
            opacity: texture(device, size, OPACITY_FORMAT, DRAWN_AND_READ | Usage::COPY_SRC),
        };
        Self {
            size,
            layers: (0..MAX_LAYERS).map(layer).collect(),
            cores: texture(device, size, LAYER_FORMAT, DRAWN_AND_READ | Usage::COPY_SRC),
            depth: texture(device, size, DEPTH_FORMAT, Usage::RENDER_ATTACHMENT),
            surfels: full(COLOUR_FORMAT),
            intervals: full(INTERVAL_FORMAT),
            throughs: full(THROUGH_FORMAT),
            sums: full(sums),
        }
    }
}

impl PerPrimitive {
    pub fn new(device: &wgpu::Device, scene: &SceneTextures) -> Self {
        let of = |grid: Grid, format| texture(device, grid.size(), format, DRAWN_AND_READ);
        let coloured = if scene.is_peeled() { scene.surfels.grid } else { scene.gaussians.grid };
        Self {
            colours: of(coloured, COLOUR_FORMAT),
            firsts: of(scene.gaussians.grid, RECORD_FORMAT),
            seconds: of(scene.gaussians.grid, RECORD_FORMAT),
        }
    }
}
