//! Scenes whose cells come and go.

use std::ops::Range;

use dpges_core::scene::SceneData;

use super::RasterRenderer;
use crate::error::Result;
use crate::scene::{Fades, PackedCell, Places, SceneTextures, joined};

impl RasterRenderer {
    /// Takes, in place of what was there, a scene of which nothing is there yet but what all cells share, with room for as
    /// many surfels and Gaussians. `coarse` gives the range of depths.
    ///
    /// # Errors
    /// [`RenderError::TooMany`](crate::RenderError::TooMany), [`RenderError::Input`](crate::RenderError::Input) as
    /// [`upload`](Self::upload); what was there stays.
    pub(crate) fn open_pages(&mut self, coarse: &SceneData, room: [usize; 2]) -> Result<()> {
        let textures = SceneTextures::with_room(&self.device, coarse, room)?;
        let fades = Fades::new(&self.device, &textures)?;
        self.take(textures, Vec::new(), Default::default(), Some(fades));
        Ok(())
    }

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
            // one command for each
            joined(all)
        });
    }
}
