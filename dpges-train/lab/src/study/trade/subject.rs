//! The study of a trade, and the subject that all of its rows share.

use std::path::Path;

use dpges_core::scene::atomic::make_folder;
use dpges_train::dataset::Split;
use dpges_train::eval::pictures::{photograph, save_png};
use serde_json::json;

use super::super::Result;
use super::super::store::{Figure, Study, checksum};
use super::SHAPE;
use super::bench::{Bench, PICTURES};

/// The study in the folder of `bench` of the file `scene`, with the first photograph. `dataset` is named as runs name it, and
/// `device` is the name of the adapter or device that draws.
///
/// # Errors
/// Those of [`Study::open`]; if the scene or the photograph cannot be read, or the picture not be written.
pub fn study(bench: &Bench, scene: &Path, dataset: &str, split: Split, device: &str) -> Result<Study> {
    let path = std::path::absolute(scene)?;
    let first = &bench.views[0].camera;
    let frame = (bench.sized)(first);
    let subject = json!({
        "scene": path.display().to_string(),
        "scene_checksum": checksum(&std::fs::read(&path)?),
        "dataset": dataset,
        "split": split.to_string(),
        "views": bench.views.iter().map(|view| &view.name).collect::<Vec<_>>(),
        "view_size": [first.width, first.height],
        "frame_size": [frame.width, frame.height],
        "rounds": bench.rounds,
        "device": device,
    });
    let drawn_on = format!("Drawn on {device}.");
    tracing::info!("{drawn_on}");
    make_folder(&bench.folder.join(PICTURES))?;
    let mut study = Study::open(&SHAPE, bench.folder, subject.as_object().cloned().unwrap_or_default())?;
    study.content.notes.push(drawn_on);
    let file = format!("{PICTURES}/photograph.png");
    save_png(&photograph(&*bench.views[0].picture()?), &bench.folder.join(&file))?;
    study.content.figures.push(Figure { file, caption: "photograph".to_owned() });
    Ok(study)
}
