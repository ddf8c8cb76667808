//! Scenes whose cells come and go.

use std::ops::Range;

use dpges_core::scene::SceneData;

use super::Renderer;
use crate::error::Result;
use crate::scene::{Fades, PackedCell, Places, SceneTextures};

impl Renderer {
    /// Takes, in place of what was there, a scene of which nothing is there yet but what all cells share, with room for as
    /// many surfels and Gaussians. `coarse` gives the range of depths.
    ///
    /// # Errors
    /// [`RenderError::TooMany`](crate::RenderError::TooMany), [`RenderError::Input`](crate::RenderError::Input) as
    /// [`upload`](Self::upload); what was there stays.
    pub(crate) fn open_pages(&mut self, coarse: &SceneData, room: [usize; 2]) -> Result<()> {
        let textures = SceneTextures::with_room(&self.device, &self.queue, coarse, room)?;
        let fades = Fades::new(&self.device, &textures)?;
        self.take(textures, Vec::new(), [Vec::new(), Vec::new()], Some(fades));
        Ok(())
    }

    /// Writes a cell to its places.
    pub(crate) fn write_cell(&self, cell: &PackedCell, places: &Places) {
        if let Some(scene) = &self.scene {
            cell.write(&self.queue, &scene.textures, places);
        }
    }

    /// Says what of the cells is drawn: their places, the factors of the sizes of surfels and of the weights of Gaussians.
    pub(crate) fn draw_cells(&mut self, drawn: &[(&Places, [f32; 2])]) {
        let Some(scene) = &mut self.scene else { return };
        if let Some(fades) = &scene.fades {
            fades.write(&self.queue, drawn.iter().copied());
        }
        scene.drawn = [0, 1].map(|kind: usize| {
            let mut all: Vec<Range<u32>> = drawn.iter().flat_map(|(places, _)| places[kind].clone()).collect();
            all.sort_unstable_by_key(|range| range.start);
            // cells that follow each other are drawn by one command
            all.into_iter().fold(Vec::new(), |mut joined: Vec<Range<u32>>, range| {
                match joined.last_mut() {
                    Some(last) if last.end == range.start => last.end = range.end,
                    _ => joined.push(range),
                }
                joined
            })
        });
    }
}
