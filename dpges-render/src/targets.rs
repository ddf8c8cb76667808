//! The textures that a picture of one size goes through.

use crate::options::MAX_LAYERS;
use crate::passes::{
    COLOUR_FORMAT, DEPTH_FORMAT, INTERVAL_FORMAT, LAYER_FORMAT, OPACITY_FORMAT, RECORD_FORMAT, THIRD_FORMAT,
};
use crate::scene::{Grid, SceneTextures};

/// A layer of every pixel.
#[derive(Debug)]
pub(crate) struct Layer {
    pub texture: wgpu::Texture,
    pub nearest: wgpu::TextureView,
    pub opacity: wgpu::TextureView,
}

#[derive(Debug)]
pub(crate) struct Targets {
    pub width: u32,
    pub height: u32,
    pub layers: Vec<Layer>,
    /// The nearest opaque fragment of every pixel, as a layer.
    pub cores: wgpu::TextureView,
    pub depth: wgpu::TextureView,
    pub surfels: wgpu::TextureView,
    pub intervals: wgpu::TextureView,
    pub thirds: wgpu::TextureView,
    pub sums: wgpu::TextureView,
}

/// Values of each primitive for one camera.
#[derive(Debug)]
pub(crate) struct PerPrimitive {
    /// Colours of surfels, or of discs.
    pub colours: wgpu::TextureView,
    pub firsts: wgpu::TextureView,
    pub seconds: wgpu::TextureView,
}

pub(crate) fn texture(
    device: &wgpu::Device,
    size: wgpu::Extent3d,
    format: wgpu::TextureFormat,
    more: wgpu::TextureUsages,
) -> wgpu::Texture {
    device.create_texture(&wgpu::TextureDescriptor {
        label: None,
        size,
        mip_level_count: 1,
        sample_count: 1,
        dimension: wgpu::TextureDimension::D2,
        format,
        usage: wgpu::TextureUsages::RENDER_ATTACHMENT | more,
        view_formats: &[],
    })
}

pub(crate) fn view(texture: &wgpu::Texture) -> wgpu::TextureView {
    texture.create_view(&wgpu::TextureViewDescriptor::default())
}

impl Targets {
    pub fn new(device: &wgpu::Device, width: u32, height: u32, sums: wgpu::TextureFormat) -> Self {
        use wgpu::TextureUsages as Usage;
        let size = wgpu::Extent3d { width, height, depth_or_array_layers: 1 };
        let full = |format| view(&texture(device, size, format, Usage::TEXTURE_BINDING));
        let layer = |_| {
            let texture = texture(device, size, LAYER_FORMAT, Usage::TEXTURE_BINDING | Usage::COPY_SRC);
            Layer { nearest: view(&texture), texture, opacity: full(OPACITY_FORMAT) }
        };
        Self {
            width,
            height,
            layers: (0..MAX_LAYERS).map(layer).collect(),
            cores: full(LAYER_FORMAT),
            depth: view(&texture(device, size, DEPTH_FORMAT, Usage::empty())),
            surfels: full(COLOUR_FORMAT),
            intervals: full(INTERVAL_FORMAT),
            thirds: full(THIRD_FORMAT),
            sums: full(sums),
        }
    }
}

impl PerPrimitive {
    pub fn new(device: &wgpu::Device, scene: &SceneTextures) -> Self {
        let of = |grid: Grid, format| view(&texture(device, grid.size(), format, wgpu::TextureUsages::TEXTURE_BINDING));
        let coloured = if scene.is_peeled() { scene.surfels.grid } else { scene.gaussians.grid };
        Self {
            colours: of(coloured, COLOUR_FORMAT),
            firsts: of(scene.gaussians.grid, RECORD_FORMAT),
            seconds: of(scene.gaussians.grid, RECORD_FORMAT),
        }
    }
}
