//! Held-out views as every method shows them, side by side.

use std::path::Path;

use dpges_core::scene::SceneData;
use dpges_render::{Rgb8Image, false_colour};
use dpges_train::eval::LARGEST_PSNR;
use dpges_train::eval::pictures::{file_stems, save_png, sheet};
use dpges_train::eval::rendered::{Renderer, to_picture};
use dpges_train::run::folder::RunFolder;
use serde::Serialize;

use super::super::series::Common;
use super::super::series::row::Row;
use crate::cli::Result;
use crate::cli::eval::make_folder;

/// Largest number of sheets.
const COUNT: usize = 3;
/// Folder of the sheets in that of the comparison.
const FOLDER: &str = "pictures";

/// The sheets of a comparison, and what is on them.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Pictures {
    /// Of the runs that are shown.
    pub seed: u64,
    /// From left to right: `photograph`, then the methods.
    pub columns: Vec<&'static str>,
    /// From top to bottom: `picture`, then `error`.
    pub rows: [&'static str; 2],
    /// Mean absolute difference per channel, as a share of full scale, that is yellow in the row of errors; none is dark
    /// blue.
    pub largest_error: f32,
    pub sheets: Vec<Sheet>,
}

/// One picture.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Sheet {
    /// Relative to the folder of the comparison.
    pub file: String,
    /// Name of the held-out view.
    pub view: String,
    /// `worst` for the first method, or `evenly spaced`.
    pub chosen: &'static str,
    /// dB, of each method in the order of the columns.
    pub psnr: Vec<Option<f64>>,
}

/// Writes a PNG for each chosen view into the folder `out` of a comparison.
pub fn write(out: &Path, rows: &[Row], common: &Common) -> Result<Pictures> {
    let views = &common.dataset.test;
    let psnr_of = |row: &Row, name: &str| row.runs[0].views.iter().find(|view| view.name == name).map(|view| view.psnr);
    let of_first: Vec<f64> = views
        .iter()
        .map(|view| rows.first().and_then(|row| psnr_of(row, &view.name)).unwrap_or(LARGEST_PSNR))
        .collect();
    let chosen = chosen(&of_first);
    let mut renders = vec![Vec::with_capacity(rows.len()); chosen.len()];
    for row in rows {
        let scene = SceneData::load(&RunFolder::new(out.join(&row.runs[0].folder)).scene())?;
        let renderer = Renderer::new(&scene, &common.device);
        for (renders, &view) in renders.iter_mut().zip(&chosen) {
            renders.push(to_picture(renderer.render(&views[view].camera)?.image()));
        }
    }
    make_folder(&out.join(FOLDER))?;
    let stems = file_stems(views);
    let write = |(index, (&view, renders)): (usize, (&usize, &Vec<Rgb8Image>))| -> Result<Sheet> {
        let file = format!("{FOLDER}/{}.png", stems[view]);
        let view = &views[view];
        save_png(&sheet(view, renders)?, &out.join(&file))?;
        Ok(Sheet {
            file,
            view: view.name.clone(),
            chosen: if index == 0 { "worst" } else { "evenly spaced" },
            psnr: rows.iter().map(|row| psnr_of(row, &view.name)).collect(),
        })
    };
    Ok(Pictures {
        seed: rows.first().map_or(0, |row| row.runs[0].seed),
        columns: std::iter::once("photograph").chain(rows.iter().map(|row| row.label)).collect(),
        rows: ["picture", "error"],
        largest_error: false_colour::LARGEST_ERROR,
        sheets: chosen.iter().zip(&renders).enumerate().map(write).collect::<Result<_>>()?,
    })
}

/// Indices of the views that are shown: the one with the lowest PSNR, then others, evenly spaced among the rest.
fn chosen(psnr: &[f64]) -> Vec<usize> {
    let Some(worst) = (0..psnr.len()).min_by(|&a, &b| psnr[a].total_cmp(&psnr[b])) else { return Vec::new() };
    let rest: Vec<usize> = (0..psnr.len()).filter(|&index| index != worst).collect();
    let count = rest.len().min(COUNT - 1);
    let spaced = (0..count).map(|index| rest[(2 * index + 1) * rest.len() / (2 * count)]);
    std::iter::once(worst).chain(spaced).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_worst_view_and_two_others_are_shown() {
        // of 0, 1, 3, 4, 5, 6, 7, 8: the middles of both halves
        assert_eq!(chosen(&[9.0, 8.0, 1.0, 8.0, 8.0, 8.0, 8.0, 8.0, 2.0]), [2, 3, 7]);
        assert_eq!(chosen(&[20.0, 30.0, 10.0]), [2, 0, 1]);
        assert_eq!(chosen(&[20.0, 10.0]), [1, 0]);
        assert_eq!(chosen(&[5.0]), [0]);
        assert_eq!(chosen(&[]), [0usize; 0]);
    }
}
