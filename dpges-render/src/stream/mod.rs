//! Scenes in levels of detail that are larger than memory: the cells that a camera needs are loaded within a budget of
//! primitives, and drawn from buffers of its size.
//!
//! [`LodScene`] is what has to be there first: the index, the sky, the coarsest level. [`Stream`] chooses cells, and says
//! which to load; it does no input and output itself, so that a page in a browser shares it. [`Loader`] loads them on threads,
//! from a folder or a web server.

mod cut;
#[cfg(test)]
pub(crate) mod fixtures;
#[cfg(test)]
mod gpu_tests;
#[cfg(not(target_arch = "wasm32"))]
mod loader;
mod pages;
mod residency;
mod scene;
#[cfg(not(target_arch = "wasm32"))]
mod source;
#[cfg(all(test, feature = "http"))]
mod source_tests;
#[cfg(test)]
mod tests;

use std::collections::VecDeque;

use dpges_core::camera::Camera;
use dpges_core::scene::lod::{Cell, Index, Part};

#[cfg(not(target_arch = "wasm32"))]
pub use loader::{Levels, Loader};
pub use scene::{LodScene, StreamError};
#[cfg(not(target_arch = "wasm32"))]
pub use source::{Source, is_address, is_lod};

use crate::renderer::RasterRenderer;
pub use crate::scene::PackedCell as LoadedCell;
use crate::scene::{PAGE, Places};
use pages::Pages;
use residency::Residency;

/// Primitives that are resident at most where no budget is given: what a desktop draws at tens of frames a second.
pub const DEFAULT_BUDGET: usize = 2_000_000;
/// A number of primitives, as in `2M`, `500k` or `1234567`.
pub fn parse_budget(text: &str) -> Result<usize, String> {
    let (number, factor) = match text.char_indices().last() {
        Some((at, 'k')) => (&text[..at], 1e3),
        Some((at, 'M')) => (&text[..at], 1e6),
        _ => (text, 1.0),
    };
    let count = number.parse::<f64>().ok().map(|number| number * factor);
    match count.filter(|count| (1.0..=u32::MAX as f64).contains(count)) {
        Some(count) => Ok(count as usize),
        None => Err(format!("`{text}` is no number of primitives, expected one such as 2M, 500k or 1234567")),
    }
}

/// Cells that are written to the device between two frames.
const WRITES: usize = 2;

/// Makes of the `bytes` of `cell` what [`Stream::take`] takes. Slow: made for another thread.
pub fn decode(index: &Index, cell: usize, bytes: &[u8]) -> Result<LoadedCell, String> {
    index.cell(cell, bytes).map(|scene| LoadedCell::new(&scene)).map_err(|error| error.to_string())
}

/// How far a stream is.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize)]
pub struct StreamStatus {
    /// Primitives that are drawn, loaded or being loaded; never more than the budget.
    pub resident: usize,
    pub budget: usize,
    pub loading: usize,
    /// Whether everything is there that the last camera needs, apart from what could not be loaded.
    pub complete: bool,
    /// Whether the next frame differs though the camera stays.
    pub changing: bool,
    pub changes: u64,
    /// Cells that are missing because they could not be loaded, and why the first could not.
    pub failed: usize,
    pub reason: Option<String>,
    /// Time, s, until one is tried again.
    pub retry_in: Option<f64>,
}

/// The cells of a scene in the buffers of a [`RasterRenderer`].
#[derive(Debug)]
pub struct Stream {
    residency: Residency,
    pages: [Pages; 2],
    places: Vec<Option<Places>>,
    /// Loads that have ended since the last frame.
    ended: VecDeque<(usize, Result<LoadedCell, String>)>,
    changes: u64,
}

impl Stream {
    /// Shows the coarsest level of `scene` in `renderer`, in place of what was there, within `budget` primitives.
    ///
    /// # Errors
    /// [`StreamError::Budget`] if the coarsest level is larger, [`StreamError::Render`] if the budget does not fit into
    /// textures of the device.
    pub fn new(scene: &LodScene, budget: usize, renderer: &mut RasterRenderer) -> Result<Self, StreamError> {
        let index = scene.index.clone();
        let room = room(&index, budget);
        let mut stream = Self {
            places: vec![None; index.cells.len()],
            residency: Residency::new(index, budget)?,
            pages: room.map(|count| Pages::new(count / PAGE)),
            ended: VecDeque::new(),
            changes: 0,
        };
        renderer.open_pages(&scene.coarse, room)?;
        for (root, cell) in &scene.roots {
            stream.write(renderer, *root, cell);
        }
        Ok(stream)
    }

    /// Takes the end of a load that [`update`](Self::update) asked for.
    pub fn take(&mut self, cell: usize, outcome: Result<LoadedCell, String>) {
        self.ended.push_back((cell, outcome));
    }

    /// Goes on for what `camera` sees at `now`, s of any clock, before `renderer` draws a frame. Returns the cells to load,
    /// the most urgent first.
    pub fn update(&mut self, renderer: &mut RasterRenderer, camera: &Camera, now: f64) -> Vec<usize> {
        for _ in 0..WRITES {
            let Some((cell, outcome)) = self.ended.pop_front() else { break };
            let is_wanted = self.residency.loaded(cell, outcome.as_ref().err(), now);
            if let (true, Ok(loaded)) = (is_wanted, &outcome) {
                self.write(renderer, cell, loaded);
            }
        }
        let was_fading = self.residency.is_fading();
        let orders = self.residency.update(camera, now);
        for &cell in &orders.drop {
            if let Some(places) = self.places[cell].take() {
                self.pages.iter_mut().zip(&places).for_each(|(pages, places)| pages.give(places));
            }
        }
        if self.changes == 0 || was_fading || self.residency.is_fading() {
            let drawn = self.residency.drawn(now);
            let drawn = drawn
                .iter()
                .filter_map(|&(cell, fade)| Some((self.places[cell].as_ref()?, [fade.surfels, fade.gaussians])));
            renderer.draw_cells(&drawn.collect::<Vec<_>>());
            self.changes += 1;
        }
        orders.load
    }

    /// How far it is at `now`, s.
    pub fn status(&self, now: f64) -> StreamStatus {
        let (failed, reason) = self.residency.failures();
        StreamStatus {
            resident: self.residency.resident,
            budget: self.residency.budget,
            loading: self.residency.loading,
            complete: self.residency.complete && self.ended.is_empty(),
            changing: self.residency.is_fading() || !self.ended.is_empty(),
            changes: self.changes,
            failed,
            reason: reason.map(str::to_owned),
            retry_in: self.residency.next_retry().map(|at| (at - now).max(0.0)),
        }
    }

    /// The part of a file that a cell is.
    pub fn part(&self, cell: usize) -> &Part {
        &self.residency.index.cells[cell].part
    }

    pub fn index(&self) -> &Index {
        &self.residency.index
    }

    fn write(&mut self, renderer: &RasterRenderer, cell: usize, loaded: &LoadedCell) {
        let of = &self.residency.index.cells[cell];
        let taken = [of.surfels, of.gaussians];
        let [surfels, gaussians] = [0, 1].map(|kind: usize| self.pages[kind].take(taken[kind]));
        let places = surfels.zip(gaussians).expect("`room` has pages for whatever the budget holds");
        let places = [places.0, places.1];
        renderer.write_cell(loaded, &places);
        self.places[cell] = Some(places);
    }
}

/// Surfels and Gaussians for which pages are needed, whichever cells a budget is spent on: as many as there are, or as fit
/// the budget, and a page more for each cell that is resident.
fn room(index: &Index, budget: usize) -> [usize; 2] {
    let mut smallest: Vec<usize> = index.cells.iter().map(|cell| cell.primitives()).collect();
    smallest.sort_unstable();
    let mut left = budget;
    let cells = smallest.iter().take_while(|&&count| {
        let fits = count <= left;
        left = left.saturating_sub(count);
        fits
    });
    let cells = cells.count();
    counts(&index.cells).map(|count| count.min(budget).div_ceil(PAGE) * PAGE + cells * PAGE)
}

fn counts<'a>(cells: impl IntoIterator<Item = &'a Cell>) -> [usize; 2] {
    let add = |[surfels, gaussians]: [usize; 2], cell: &Cell| [surfels + cell.surfels, gaussians + cell.gaussians];
    cells.into_iter().fold([0, 0], add)
}
