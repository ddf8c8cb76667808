//! The content of `index.json`.

use std::path::PathBuf;

use serde::{Deserialize, Serialize};

use crate::scene::SceneInfo;

pub const FORMAT: &str = "dpges-lod";
pub const VERSION: u32 = 1;

/// A scene in levels of detail.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Index {
    /// [`FORMAT`]
    pub format: String,
    /// [`VERSION`]
    pub version: u32,
    /// Rendering settings of all cells.
    pub settings: SceneInfo,
    /// A scene file without primitives, with the environment; `None` where there is only the background of the settings.
    pub sky: Option<Part>,
    /// The coarsest first, so that every cell follows its parent.
    pub cells: Vec<Cell>,
    /// Folder or address that it was read from, for messages.
    #[serde(skip)]
    pub place: PathBuf,
}

/// Bytes of a file of the folder.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Part {
    /// A name without folders.
    pub file: String,
    pub offset: u64,
    pub bytes: u64,
}

/// Primitives that are loaded together.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Cell {
    /// 0: the primitives of the scene itself. One more: about half as many.
    pub level: u32,
    /// Lowest corner of a box around most of its primitives, world units. It says how near they are: one that is far from the
    /// others is beyond it.
    pub min: [f32; 3],
    /// Highest corner.
    pub max: [f32; 3],
    /// Index of the cell that stands for this one and others; roots have none.
    pub parent: Option<usize>,
    /// Indices of the cells that this one stands for; cells of level 0 have none.
    pub children: Vec<usize>,
    #[serde(flatten)]
    pub part: Part,
    pub surfels: usize,
    pub gaussians: usize,
    /// Median over its primitives of the largest σ, world units.
    pub size: f32,
}

impl Cell {
    /// Surfels and Gaussians.
    pub fn primitives(&self) -> usize {
        self.surfels + self.gaussians
    }
}

impl Index {
    pub fn new(settings: SceneInfo) -> Self {
        let (format, cells, place) = (FORMAT.to_owned(), Vec::new(), PathBuf::new());
        Self { format, version: VERSION, settings, sky: None, cells, place }
    }

    /// Indices of the cells without a parent.
    pub fn roots(&self) -> impl Iterator<Item = usize> {
        self.cells.iter().enumerate().filter(|(_, cell)| cell.parent.is_none()).map(|(index, _)| index)
    }

    /// Indices of the cells of a level.
    pub fn level(&self, level: u32) -> impl Iterator<Item = usize> {
        self.cells.iter().enumerate().filter(move |(_, cell)| cell.level == level).map(|(index, _)| index)
    }

    /// Levels that have cells: 0 to this, which is not one of them.
    pub fn level_count(&self) -> u32 {
        self.cells.iter().map(|cell| cell.level + 1).max().unwrap_or(0)
    }

    /// All parts of files: the sky, then the cells.
    pub fn parts(&self) -> impl Iterator<Item = &Part> {
        self.sky.iter().chain(self.cells.iter().map(|cell| &cell.part))
    }

    /// The first thing that cannot be, in words.
    pub(super) fn check(&self) -> Result<(), String> {
        if self.format != FORMAT {
            return Err(format!("`format` is `{}`, expected `{FORMAT}`", self.format));
        }
        if self.version != VERSION {
            let newer = if self.version > VERSION { ": a newer dpges wrote it" } else { "" };
            return Err(format!("`version` is {}, expected {VERSION}{newer}", self.version));
        }
        if let Some(sky) = &self.sky {
            check_part(sky).map_err(|reason| format!("`sky` {reason}"))?;
        }
        let mut named = vec![0_usize; self.cells.len()];
        for (at, cell) in self.cells.iter().enumerate() {
            let wrong = |reason: String| format!("cell {at} {reason}");
            check_part(&cell.part).map_err(wrong)?;
            let numbers = || cell.min.iter().chain(&cell.max).chain([&cell.size]);
            let in_order = cell.min.iter().zip(&cell.max).all(|(low, high)| low <= high);
            if !in_order || !numbers().all(|value| value.is_finite()) || cell.size < 0.0 {
                return Err(wrong(format!(
                    "has a box from {:?} to {:?} and size {}, expected finite numbers in order",
                    cell.min, cell.max, cell.size
                )));
            }
            if (cell.level == 0) != cell.children.is_empty() {
                return Err(wrong(format!(
                    "of level {} has {} children, expected some above level 0 and none of level 0",
                    cell.level,
                    cell.children.len()
                )));
            }
            for &child in &cell.children {
                let Some(found) = self.cells.get(child) else {
                    return Err(wrong(format!("has the child {child}, and there are {} cells", self.cells.len())));
                };
                named[child] += 1;
                if found.parent != Some(at) || found.level + 1 != cell.level || child <= at {
                    return Err(wrong(format!(
                        "of level {} has the child {child}, which is of level {} and names {:?} as its parent",
                        cell.level, found.level, found.parent
                    )));
                }
            }
        }
        match self.cells.iter().zip(&named).position(|(cell, &named)| named != usize::from(cell.parent.is_some())) {
            Some(at) => Err(format!(
                "cell {at} names {:?} as its parent, and is a child of {} cells",
                self.cells[at].parent, named[at]
            )),
            None => Ok(()),
        }
    }
}

fn check_part(part: &Part) -> Result<(), String> {
    let name = &part.file;
    let plain = |c: char| c.is_ascii_alphanumeric() || matches!(c, '-' | '_' | '.');
    if name.is_empty() || name.starts_with('.') || !name.chars().all(plain) {
        return Err(format!("is in the file {name:?}, expected a name of letters, digits, `-`, `_` and `.`"));
    }
    match part.offset.checked_add(part.bytes) {
        Some(_) if part.bytes > 0 => Ok(()),
        _ => Err(format!("has {} bytes from {} on in {name}, expected at least 1", part.bytes, part.offset)),
    }
}
