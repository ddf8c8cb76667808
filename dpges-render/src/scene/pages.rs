//! A scene whose primitives come and go by pages of one cell each, and how much of each page is drawn.

use std::ops::Range;

use dpges_core::scene::SceneData;

use super::packing;
use super::textures::{Grid, Packed, SceneTextures, write};
use crate::error::Result;

/// Primitives of a page: `PAGE` of `fade_paged.wgsl`.
pub const PAGE: usize = 256;

/// Where the primitives of a cell are: surfels, Gaussians. Ranges begin with a page.
pub type Places = [Vec<Range<u32>>; 2];

/// The same ranges; those that follow each other are one.
pub fn joined(ranges: impl IntoIterator<Item = Range<u32>>) -> Vec<Range<u32>> {
    ranges.into_iter().fold(Vec::new(), |mut joined: Vec<Range<u32>>, range| {
        match joined.last_mut() {
            Some(last) if last.end == range.start => last.end = range.end,
            _ => joined.push(range),
        }
        joined
    })
}

/// A factor per page of surfels, and of Gaussians, in textures as wide as the grids of primitives.
#[derive(Debug)]
pub struct Fades {
    grids: [Grid; 2],
    pub views: [wgpu::TextureView; 2],
}

impl Fades {
    pub fn new(device: &wgpu::Device, scene: &SceneTextures) -> Result<Self> {
        let grid = |what, count: usize| Grid::new(&device.limits(), what, count.div_ceil(PAGE), 1);
        let grids = [grid("surfels", scene.surfels.count)?, grid("Gaussians", scene.gaussians.count)?];
        Ok(Self { views: grids.map(|grid| grid.texture(device, wgpu::TextureFormat::R32Float)), grids })
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

/// The primitives of a scene, or of a cell of one, as texels.
#[derive(Debug)]
pub struct PackedCell([Packed; 2]);

impl PackedCell {
    pub fn new(scene: &SceneData) -> Self {
        let SceneData { surfels, gaussians, .. } = scene;
        Self([
            Packed::new(packing::surfels(surfels), &surfels.colour),
            Packed::new(packing::gaussians(gaussians), &gaussians.colour),
        ])
    }

    pub fn write(&self, queue: &wgpu::Queue, textures: &SceneTextures, places: &Places) {
        textures.surfels.write(queue, &places[0], &self.0[0]);
        textures.gaussians.write(queue, &places[1], &self.0[1]);
    }
}
