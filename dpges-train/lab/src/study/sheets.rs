//! Held-out views as every variant shows them, side by side.

use std::path::Path;

use burn::tensor::Device;
use dpges_core::scene::SceneData;
use dpges_render::{Rgb8Image, false_colour};
use dpges_train::dataset::View;
use dpges_train::eval::pictures::{file_stems, save_png, sheet};
use dpges_train::eval::rendered::{TrainingRenderer, to_picture};
use dpges_train::eval::{LARGEST_PSNR, ViewScore};

use super::Result;
use super::cell::Cell;
use super::evaluated;
use super::store::Figure;

const COUNT: usize = 3;
const FOLDER: &str = "pictures";

/// Writes a PNG for each chosen one of the held-out `views` into the folder `out` of a study: photograph · each of `cells`,
/// which are finished; below each its error.
///
/// # Errors
/// If a scene or an evaluation cannot be read, a view cannot be rendered, or a file cannot be written.
pub fn write(out: &Path, cells: &[&Cell], views: &[View], device: &Device) -> Result<Vec<Figure>> {
    let scores: Vec<Vec<ViewScore>> = cells
        .iter()
        .map(|cell| Ok(evaluated::read(&cell.folder.evaluation())?.evaluation.views))
        .collect::<Result<_>>()?;
    let psnr =
        |scores: &[ViewScore], name: &str| scores.iter().find(|view| view.name == name).map(|view| view.scores.psnr);
    let of_first = |view: &View| scores.first().and_then(|scores| psnr(scores, &view.name)).unwrap_or(LARGEST_PSNR);
    let chosen = chosen(&views.iter().map(of_first).collect::<Vec<_>>());
    let mut renders = vec![Vec::<Rgb8Image>::with_capacity(cells.len()); chosen.len()];
    for cell in cells {
        let scene = SceneData::load(&cell.folder.scene())?;
        let renderer = TrainingRenderer::new(&scene, device);
        for (renders, &view) in renders.iter_mut().zip(&chosen) {
            renders.push(to_picture(renderer.render(&views[view].camera)?.image()));
        }
    }
    std::fs::create_dir_all(out.join(FOLDER))?;
    let stems = file_stems(views.iter().map(|view| &*view.name));
    let mut figures = Vec::new();
    for (index, (&at, renders)) in chosen.iter().zip(&renders).enumerate() {
        let (file, view) = (format!("{FOLDER}/{}.png", stems[at]), &views[at]);
        save_png(&sheet(view, renders)?, &out.join(&file))?;
        let of_cells: Vec<String> = cells
            .iter()
            .zip(&scores)
            .map(|(cell, scores)| {
                let psnr = psnr(scores, &view.name).map(|psnr| format!(" {psnr:.2} dB")).unwrap_or_default();
                format!("{}{psnr}", cell.variant.label)
            })
            .collect();
        let worst = if index == 0 { ", the worst of the first" } else { "" };
        let largest = false_colour::LARGEST_ERROR;
        let caption = format!(
            "{}{worst}: photograph · {}; below each its mean error per channel, dark blue where there is none and yellow \
             from {largest} of full scale",
            view.name,
            of_cells.join(" · "),
        );
        figures.push(Figure { file, caption });
    }
    Ok(figures)
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
