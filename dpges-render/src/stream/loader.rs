//! Threads that load cells.

use std::path::Path;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Instant;

use dpges_core::camera::Camera;
use dpges_core::scene::lod::Index;

use super::residency::FADE_S;
use super::{LoadedCell, LodScene, Source, Stream, StreamError, StreamStatus, decode};
use crate::renderer::RasterRenderer;

/// Most threads: servers answer few requests of one reader at a time.
const THREADS: usize = 4;

type Outcome = (usize, Result<LoadedCell, String>);

/// A scene in levels of detail that can be shown: where it is, what has to be there first, and the budget.
#[derive(Debug)]
pub struct Levels {
    source: Source,
    scene: LodScene,
    cameras: Vec<Camera>,
    budget: usize,
}

impl Levels {
    /// Opens the folder or address `place`.
    ///
    /// # Errors
    /// The errors of [`Source::new`], [`Source::index`], [`Source::read`], [`Source::cameras`] and [`LodScene::new`].
    pub fn open(place: &Path, budget: usize) -> Result<Self, StreamError> {
        let source = Source::new(place)?;
        let scene = LodScene::new(source.index()?, |part| source.read(part))?;
        let cameras = source.cameras(scene.index.settings.near)?;
        Ok(Self { source, scene, cameras, budget })
    }

    /// Those that the scene was exported with.
    pub fn cameras(&self) -> &[Camera] {
        &self.cameras
    }

    pub fn scene(&self) -> &LodScene {
        &self.scene
    }
}

/// A stream whose cells are loaded by threads, from a folder or a web server.
pub struct Loader {
    stream: Stream,
    asked: Sender<usize>,
    ended: Receiver<Outcome>,
    opened: Instant,
    /// Time that was skipped, s.
    skipped: f64,
}

impl Loader {
    /// Shows `levels` in `renderer`. Calls `wake` whenever a cell has come.
    pub fn new(
        Levels { source, scene, budget, .. }: Levels,
        renderer: &mut RasterRenderer,
        wake: impl Fn() + Send + Clone + 'static,
    ) -> Result<Self, StreamError> {
        let stream = Stream::new(&scene, budget, renderer)?;
        let (asked, cells) = channel();
        let (end, ended) = channel();
        let (index, cells) = (Arc::new(scene.index.clone()), Arc::new(Mutex::new(cells)));
        let threads = std::thread::available_parallelism().map_or(1, |count| count.get().min(THREADS));
        for _ in 0..threads {
            let (source, index, cells) = (source.clone(), Arc::clone(&index), Arc::clone(&cells));
            let (end, wake) = (end.clone(), wake.clone());
            std::thread::spawn(move || work(&source, &index, &cells, &end, &wake));
        }
        Ok(Self { stream, asked, ended, opened: Instant::now(), skipped: 0.0 })
    }

    /// Goes on for what `camera` sees, before `renderer` draws a frame.
    pub fn update(&mut self, renderer: &mut RasterRenderer, camera: &Camera) {
        while let Ok((cell, outcome)) = self.ended.try_recv() {
            self.stream.take(cell, outcome);
        }
        for cell in self.stream.update(renderer, camera, self.now()) {
            // the threads live as long as the other end
            if self.asked.send(cell).is_err() {
                self.stream.take(cell, Err(STOPPED.to_owned()));
            }
        }
    }

    /// How far it is.
    pub fn status(&self) -> StreamStatus {
        self.stream.status(self.now())
    }

    /// Goes on until everything is there that `camera` needs, and nothing fades. Returns the largest number of primitives
    /// that were resident on the way.
    ///
    /// # Errors
    /// [`StreamError::Cell`] if a cell cannot be loaded.
    pub fn complete(&mut self, renderer: &mut RasterRenderer, camera: &Camera) -> Result<usize, StreamError> {
        let mut most = 0;
        loop {
            self.update(renderer, camera);
            let status = self.status();
            most = most.max(status.resident);
            if let Some(reason) = status.reason {
                return Err(StreamError::Cell(reason));
            }
            if status.complete {
                return Ok(most);
            }
            if status.loading > 0 && !status.changing {
                let (cell, outcome) = self.ended.recv().map_err(|_| StreamError::Cell(STOPPED.to_owned()))?;
                self.stream.take(cell, outcome);
            }
            self.skipped += FADE_S;
        }
    }

    fn now(&self) -> f64 {
        self.opened.elapsed().as_secs_f64() + self.skipped
    }
}

const STOPPED: &str = "the threads that load cells have stopped";

fn work(source: &Source, index: &Index, cells: &Mutex<Receiver<usize>>, end: &Sender<Outcome>, wake: &impl Fn()) {
    loop {
        let next = cells.lock().unwrap_or_else(PoisonError::into_inner).recv();
        let Ok(cell) = next else { return };
        let bytes = source.read(&index.cells[cell].part).map_err(|error| error.to_string());
        let outcome = bytes.and_then(|bytes| decode(index, cell, &bytes));
        if end.send((cell, outcome)).is_err() {
            return;
        }
        wake();
    }
}
