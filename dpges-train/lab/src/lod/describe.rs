//! Description of a folder with a scene in levels of detail.

use std::path::Path;

use dpges_core::Result;
use dpges_core::scene::lod::{Cell, INDEX, Index};
use serde::Serialize;

/// A scene in levels of detail.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Description {
    /// Of all files.
    pub bytes: u64,
    /// Of the sky; 0 without one.
    pub sky_bytes: u64,
    /// From level 0.
    pub levels: Vec<Level>,
}

/// The cells of a level.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Level {
    pub level: u32,
    pub cells: usize,
    pub surfels: usize,
    pub gaussians: usize,
    pub bytes: u64,
    /// Primitives of the largest cell.
    pub largest_cell: usize,
    /// Middle of the sizes of its cells, world units.
    pub size: f32,
}

/// Whether `path` is a folder with a scene in levels of detail.
pub fn is_lod(path: &Path) -> bool {
    path.join(INDEX).is_file()
}

/// Describes the folder `path`.
///
/// # Errors
/// The errors of [`Index::open`].
pub fn describe(path: &Path) -> Result<Description> {
    Ok(of(&Index::open(path)?))
}

/// Describes `index`.
pub fn of(index: &Index) -> Description {
    let level = |level: u32| {
        let cells: Vec<&Cell> = index.level(level).map(|at| &index.cells[at]).collect();
        let mut sizes: Vec<f32> = cells.iter().map(|cell| cell.size).collect();
        sizes.sort_unstable_by(f32::total_cmp);
        Level {
            level,
            cells: cells.len(),
            surfels: cells.iter().map(|cell| cell.surfels).sum(),
            gaussians: cells.iter().map(|cell| cell.gaussians).sum(),
            bytes: cells.iter().map(|cell| cell.part.bytes).sum(),
            largest_cell: cells.iter().map(|cell| cell.primitives()).max().unwrap_or(0),
            size: sizes.get(sizes.len() / 2).copied().unwrap_or(0.0),
        }
    };
    let bytes = index.parts().map(|part| part.bytes).sum();
    let sky_bytes = index.sky.as_ref().map_or(0, |sky| sky.bytes);
    Description { bytes, sky_bytes, levels: (0..index.level_count()).map(level).collect() }
}

impl Description {
    /// As names and values.
    pub fn rows(&self) -> Vec<(&'static str, String)> {
        let mut rows = vec![
            (
                "size",
                format!("{:.2} MB, of which the sky {:.2} MB", self.bytes as f64 / 1e6, self.sky_bytes as f64 / 1e6),
            ),
            ("levels", "level  cells    surfels  Gaussians         MB  size of a primitive".to_owned()),
        ];
        for Level { level, cells, surfels, gaussians, bytes, size, .. } in self.levels.iter().rev() {
            let megabytes = *bytes as f64 / 1e6;
            let line = format!("{level:5} {cells:6} {surfels:10} {gaussians:10} {megabytes:10.2}  {size:.4}");
            rows.push(("", line));
        }
        rows
    }
}
