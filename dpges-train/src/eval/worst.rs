//! The views that metrics find worst.

use std::collections::BTreeMap;
use std::collections::btree_map::Entry;
use std::path::Path;

use dpges_core::Result;
use dpges_render::Rgb8Image;

use super::Evaluation;
use super::pictures::{save_png, with_flip};
use super::rendered::TrainingRenderer;
use crate::dataset::View;
use crate::metrics::{METRICS, Scores};

/// Writes the worst of `views` by each metric of their `evaluation` as `worst_METRIC.png` into `folder`. Returns what is worst
/// and where its picture is.
///
/// # Errors
/// If a view cannot be rendered, or a picture not be written.
pub fn write(
    folder: &Path,
    evaluation: &Evaluation,
    views: &[View],
    renderer: &TrainingRenderer,
) -> Result<Vec<String>> {
    let scores: Vec<Scores> = evaluation.views.iter().map(|view| view.scores).collect();
    let mut pictures: BTreeMap<usize, Rgb8Image> = BTreeMap::new();
    let mut written = Vec::new();
    for metric in &METRICS {
        let Some(index) = metric.worst(&scores) else { continue };
        let view = &views[index];
        let picture = match pictures.entry(index) {
            Entry::Occupied(drawn) => drawn.into_mut(),
            Entry::Vacant(entry) => entry.insert(with_flip(view, &renderer.render(&view.camera)?)?),
        };
        let path = folder.join(format!("worst_{}.png", metric.key));
        save_png(picture, &path)?;
        let value = metric.text(metric.of(&scores[index]));
        written.push(format!("{} {value}: {}, {}", metric.title, view.name, path.display()));
    }
    Ok(written)
}
