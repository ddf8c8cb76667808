//! The textures of a scene, laid out as grids: primitive i stands in row i / width.

use std::ops::Range;

use dpges_core::scene::{ColourData, ColourModel, Rendering, SceneData, SceneInfo};

use super::colours;
use super::packing::Shapes;
use crate::error::{RenderError, Result};
use crate::texture;

/// Widest grid, px.
const WIDEST: u32 = 8192;

/// How texels that belong to primitives are laid out in a texture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Grid {
    /// Width = 2^this.
    pub log2_width: u32,
    pub rows: u32,
}

impl Grid {
    pub fn new(limits: &wgpu::Limits, what: &'static str, count: usize, texels: usize) -> Result<Self> {
        let side_px = limits.max_texture_dimension_2d;
        let log2_width = side_px.min(WIDEST).ilog2();
        let most = (side_px as usize) << log2_width;
        let rows = (count * texels).div_ceil(1 << log2_width).max(1);
        if rows > side_px as usize {
            return Err(RenderError::TooMany { what, count, most: most / texels, side_px });
        }
        Ok(Self { log2_width, rows: rows as u32 })
    }

    pub fn size(self) -> wgpu::Extent3d {
        texture::size(1 << self.log2_width, self.rows)
    }

    pub fn len(self) -> usize {
        (self.rows as usize) << self.log2_width
    }

    /// A texture that is written by the host and read by shaders.
    pub fn texture(self, device: &wgpu::Device, format: wgpu::TextureFormat) -> wgpu::TextureView {
        let usage = wgpu::TextureUsages::TEXTURE_BINDING | wgpu::TextureUsages::COPY_DST;
        texture::texture(device, self.size(), format, usage)
    }
}

/// Primitives of one kind as texels.
#[derive(Debug)]
pub struct Packed {
    shapes: Shapes,
    /// See [`colours`].
    colours: Vec<[u32; 4]>,
    model: ColourModel,
}

impl Packed {
    pub fn new(shapes: Shapes, colour: &ColourData) -> Self {
        Self { shapes, colours: colours::pack(colour), model: colour.model }
    }
}

/// Primitives of one kind.
#[derive(Debug)]
pub struct Primitives {
    pub count: usize,
    pub grid: Grid,
    /// Rgba32Float: position, margin of a surfel or opacity of a Gaussian.
    pub places: wgpu::TextureView,
    /// Rgba32Uint: see [`packing`](super::packing).
    pub forms: wgpu::TextureView,
    /// Rgba32Uint: see [`colours`].
    pub colours: wgpu::TextureView,
}

impl Primitives {
    /// Room for `count`, of which none is there.
    fn with_room(device: &wgpu::Device, what: &'static str, count: usize, model: ColourModel) -> Result<Self> {
        let limits = device.limits();
        let grid = Grid::new(&limits, what, count, 1)?;
        let wide = Grid::new(&limits, what, count, colours::texels(model))?;
        Ok(Self {
            count,
            grid,
            places: grid.texture(device, wgpu::TextureFormat::Rgba32Float),
            forms: grid.texture(device, wgpu::TextureFormat::Rgba32Uint),
            colours: wide.texture(device, wgpu::TextureFormat::Rgba32Uint),
        })
    }

    /// Writes `packed` to the `places` in the grid, whose lengths add up to their number.
    pub fn write(&self, queue: &wgpu::Queue, places: &[Range<u32>], packed: &Packed) {
        let texels = colours::texels(packed.model);
        let mut from = 0;
        for place in places {
            let (start, part) = (place.start as usize, from..from + place.len());
            write(queue, &self.places, self.grid, start, &packed.shapes.places[part.clone()]);
            write(queue, &self.forms, self.grid, start, &packed.shapes.forms[part.clone()]);
            let part = part.start * texels..part.end * texels;
            write(queue, &self.colours, self.grid, start * texels, &packed.colours[part]);
            from += place.len();
        }
    }
}

/// Writes `texels` of a texture with the width of `grid` from texel `start` on.
pub fn write<T: bytemuck::Pod>(queue: &wgpu::Queue, view: &wgpu::TextureView, grid: Grid, start: usize, texels: &[T]) {
    let width = 1 << grid.log2_width;
    let (mut at, mut rest) = (start, texels);
    while !rest.is_empty() {
        let (x, y) = (at % width, at / width);
        let size =
            if x == 0 && rest.len() >= width { [width, rest.len() / width] } else { [rest.len().min(width - x), 1] };
        let (now, later) = rest.split_at(size[0] * size[1]);
        let origin = wgpu::Origin3d { x: x as u32, y: y as u32, z: 0 };
        let to = wgpu::TexelCopyTextureInfo { origin, ..view.texture().as_image_copy() };
        let bytes_per_row = Some((size[0] * size_of::<T>()) as u32);
        let layout = wgpu::TexelCopyBufferLayout { offset: 0, bytes_per_row, rows_per_image: None };
        let size = texture::size(size[0] as u32, size[1] as u32);
        queue.write_texture(to, bytemuck::cast_slice(now), layout, size);
        (at, rest) = (at + now.len(), later);
    }
}

/// A scene on a device.
#[derive(Debug)]
pub struct SceneTextures {
    pub info: SceneInfo,
    /// Coefficients of the environment; empty for a scene without one.
    pub environment: Vec<[f32; 3]>,
    pub surfels: Primitives,
    pub gaussians: Primitives,
    pub colour_texels: usize,
    /// World positions `[n, 3]` of at most a few thousand primitives.
    pub sample: Vec<[f32; 3]>,
}

/// Positions that are looked at to find the range of depths.
const SAMPLE: usize = 4096;

impl SceneTextures {
    /// Room for as many surfels and Gaussians, of which none is there; everything else is that of `scene`.
    pub fn with_room(device: &wgpu::Device, scene: &SceneData, [surfels, gaussians]: [usize; 2]) -> Result<Self> {
        let model = scene.info.colour_model;
        let surfels = Primitives::with_room(device, "surfels", surfels, model)?;
        let gaussians = Primitives::with_room(device, "Gaussians", gaussians, model)?;
        let all = if scene.surfels.is_empty() { &scene.gaussians.positions } else { &scene.surfels.positions };
        let (positions, _) = all.as_chunks::<3>();
        let sample = positions.iter().step_by((positions.len() / SAMPLE).max(1)).copied().collect();
        let colour_texels = colours::texels(scene.info.colour_model);
        let environment = match &scene.environment {
            Some(environment) => {
                environment.check()?;
                environment.coefficients.as_chunks::<3>().0.to_vec()
            }
            None => Vec::new(),
        };
        Ok(Self { info: scene.info.clone(), environment, surfels, gaussians, colour_texels, sample })
    }

    pub fn is_peeled(&self) -> bool {
        self.info.rendering == Rendering::Peeled
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_grid_has_room_for_all_and_refuses_more() {
        let limits = wgpu::Limits { max_texture_dimension_2d: 2048, ..wgpu::Limits::default() };
        let grid = |count, texels| Grid::new(&limits, "surfels", count, texels);
        assert_eq!(grid(0, 2).unwrap(), Grid { log2_width: 11, rows: 1 });
        assert_eq!(grid(1025, 2).unwrap(), Grid { log2_width: 11, rows: 2 });
        assert_eq!(grid(1 << 22, 1).unwrap().rows, 2048);
        let error = grid((1 << 21) + 1, 2).unwrap_err().to_string();
        assert!(error.contains("2097153 surfels are more than the 2097152"), "{error}");
    }
}
