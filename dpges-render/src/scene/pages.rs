//! A scene whose primitives come and go by pages of one cell each, and how much of each page is drawn.

use std::ops::Range;

use dpges_core::scene::SceneData;

use super::textures::{Grid, Packed, SceneTextures, descriptor, write};
use crate::error::Result;

/// Primitives of a page: `PAGE` of `fade_paged.wgsl`.
pub const PAGE: usize = 256;

/// Where the primitives of a cell are: surfels, Gaussians. Ranges begin with a page.
pub type Places = [Vec<Range<u32>>; 2];

/// A factor per page of surfels, and of Gaussians, in textures as wide as the grids of primitives.
#[derive(Debug)]
pub struct Fades {
    grids: [Grid; 2],
    pub views: [wgpu::TextureView; 2],
}

impl Fades {
    /// # Errors
    /// [`RenderError::TooMany`](crate::RenderError::TooMany), which the textures of the primitives themselves are the first to have.
    pub fn new(device: &wgpu::Device, scene: &SceneTextures) -> Result<Self> {
        let grid = |what, count: usize| Grid::new(&device.limits(), what, count.div_ceil(PAGE), 1);
        let grids = [grid("surfels", scene.surfels.count)?, grid("Gaussians", scene.gaussians.count)?];
        let view = |grid: Grid| {
            let texture = device.create_texture(&descriptor(grid, wgpu::TextureFormat::R32Float));
            texture.create_view(&wgpu::TextureViewDescriptor::default())
        };
        Ok(Self { views: grids.map(view), grids })
    }

    /// Writes the factors of all pages: those of cells that are drawn, and 0 elsewhere.
    pub fn write<'a>(&self, queue: &wgpu::Queue, drawn: impl Iterator<Item = (&'a Places, [f32; 2])>) {
        let mut tables = self.grids.map(|grid| vec![0f32; grid.len()]);
        for (places, factors) in drawn {
            for ((table, places), factor) in tables.iter_mut().zip(places).zip(factors) {
                for place in places {
                    table[place.start as usize / PAGE..(place.end as usize).div_ceil(PAGE)].fill(factor);
                }
            }
        }
        for ((view, grid), table) in self.views.iter().zip(self.grids).zip(tables) {
            write(queue, view, grid, 0, &table);
        }
    }
}

/// The primitives of a cell as texels.
#[derive(Debug)]
pub struct PackedCell([Packed; 2]);

impl PackedCell {
    pub fn new(scene: &SceneData) -> Self {
        Self([Packed::surfels(&scene.surfels), Packed::gaussians(&scene.gaussians)])
    }

    /// Writes them to their places.
    pub fn write(&self, queue: &wgpu::Queue, textures: &SceneTextures, places: &Places) {
        textures.surfels.write(queue, &places[0], &self.0[0]);
        textures.gaussians.write(queue, &places[1], &self.0[1]);
    }
}
