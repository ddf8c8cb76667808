//! Scenes in levels of detail. The page fetches the parts of files that it is asked for here.

use dpges_core::camera::Camera;
use dpges_core::scene::lod::{Index, Part};
use dpges_render::RasterRenderer;
use dpges_render::stream::{DEFAULT_BUDGET, LodScene, Stream, StreamError, decode};
use js_sys::{Array, Date, Uint8Array};
use serde::Serialize;
use wasm_bindgen::prelude::*;

use super::{Viewer, json};

/// Streams of the page, for scenes in levels of detail.
#[derive(Default)]
pub struct Levels {
    /// The index of the next scene, whose first parts are on their way.
    opened: Option<Index>,
    stream: Option<Stream>,
    /// The cells that frames have asked for.
    wanted: Vec<usize>,
}

/// A part of a file, for a cell or for the beginning.
#[derive(Serialize)]
struct Wanted<'a> {
    cell: Option<usize>,
    #[serde(flatten)]
    part: &'a Part,
}

impl Levels {
    /// Goes on for what `camera` sees, before a frame.
    pub fn advance(&mut self, renderer: &mut RasterRenderer, camera: &Camera) {
        if let Some(stream) = &mut self.stream {
            self.wanted.extend(stream.update(renderer, camera, now()));
        }
    }
}

#[wasm_bindgen]
impl Viewer {
    /// Takes the bytes of the index of a scene in levels of detail; messages call it `name`. Returns the parts that are needed
    /// before it is shown, as JSON. The scene before it stays.
    pub fn open_levels(&mut self, index: &[u8], name: &str) -> Result<String, JsError> {
        let index = Index::from_bytes(index, name)?;
        let parts = json(&LodScene::parts(&index).map(|part| Wanted { cell: None, part }).collect::<Vec<_>>())?;
        self.levels.opened = Some(index);
        Ok(parts)
    }

    /// Shows the scene whose index was opened, within `budget` primitives, if that is given, out of `parts`: the bytes of those that
    /// [`open_levels`](Self::open_levels) asked for. Returns what the scene is, as JSON.
    pub fn show_levels(&mut self, parts: &Array, budget: Option<usize>) -> Result<String, JsError> {
        let index = self.levels.opened.take().ok_or_else(|| JsError::new("no index was opened"))?;
        let mut parts = parts.iter().map(|part| Uint8Array::from(part).to_vec());
        let scene = LodScene::new(index, |part| {
            parts
                .next()
                .ok_or_else(|| StreamError::Load { place: part.file.clone(), reason: "it is missing".to_owned() })
        })?;
        let stream = Stream::new(&scene, budget.unwrap_or(DEFAULT_BUDGET), &mut self.renderer)?;
        self.levels = Levels { stream: Some(stream), ..Levels::default() };
        self.summary(scene.coarse(), scene.counts())
    }

    /// The cells that frames have asked for since the last call, and their parts, as JSON.
    pub fn wanted(&mut self) -> Result<String, JsError> {
        let cells = std::mem::take(&mut self.levels.wanted);
        let part = |cell| Some(Wanted { cell: Some(cell), part: self.levels.stream.as_ref()?.part(cell) });
        json(&cells.into_iter().filter_map(part).collect::<Vec<_>>())
    }

    /// Takes the bytes of a cell that was wanted.
    pub fn take_cell(&mut self, cell: usize, bytes: &[u8]) {
        if let Some(stream) = &mut self.levels.stream {
            let outcome = decode(stream.index(), cell, bytes);
            stream.take(cell, outcome);
        }
    }

    /// Learns why a cell that was wanted does not come.
    pub fn miss_cell(&mut self, cell: usize, reason: String) {
        if let Some(stream) = &mut self.levels.stream {
            stream.take(cell, Err(reason));
        }
    }

    /// How far the levels are, as JSON; `undefined` for other scenes.
    pub fn levels(&self) -> Result<Option<String>, JsError> {
        let Some(stream) = &self.levels.stream else { return Ok(None) };
        let status = stream.status(now());
        json(&status).map(Some)
    }
}

/// s
fn now() -> f64 {
    Date::now() / 1e3
}
