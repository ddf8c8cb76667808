//! The row of a finished run: its evaluation, and what training does not measure.

use std::path::Path;

use burn::tensor::Device;
use dpges_core::scene::SceneData;
use dpges_train::dataset::Dataset;
use dpges_train::eval::popping::Measured;
use dpges_train::eval::rendered::TrainingRenderer;
use dpges_train::eval::{EvalReport, Measures, evaluate_each};
use dpges_train::metrics::Perceptual;
use dpges_train::metrics::lpips::Lpips;
use dpges_train::run::folder::write_json;
use dpges_train::run::metrics_log::MetricsLog;

use super::cell::Cell;
use super::row::Row;
use super::{Result, StudyError};

/// Measures of the held-out views that training does not take.
#[derive(Clone, Copy)]
pub struct Further<'a> {
    pub dataset: &'a Dataset,
    pub device: &'a Device,
    /// LPIPS is measured by these.
    pub networks: &'a [Lpips],
    /// Whether popping is measured, along the same path for all.
    pub popping: bool,
}

impl Further<'_> {
    /// Adds what the evaluation of a finished `cell` lacks to its file.
    ///
    /// # Errors
    /// If the scene or the evaluation cannot be read, or a view cannot be rendered.
    pub fn measure(&self, cell: &Cell) -> Result<()> {
        let (path, views) = (cell.folder.evaluation(), &self.dataset.test);
        let mut report = read(&path)?;
        let mut known = report.evaluation.perceptual;
        let lacks_lpips = self.networks.iter().any(|lpips| known.lpips_mut(lpips.network).is_none());
        let lacks_popping = self.popping && report.popping.is_none_or(|popping| popping.jumps.is_none());
        if !lacks_lpips && !lacks_popping {
            return Ok(());
        }
        let scene = SceneData::load(&cell.folder.scene())?;
        let renderer = TrainingRenderer::new(&scene, self.device);
        if lacks_lpips {
            tracing::info!("{}: measuring LPIPS of {} views", cell.folder.path().display(), views.len());
            let measures = Measures::perceptual(self.networks);
            let found = evaluate_each(&renderer, &scene, views, measures, |_, _| Ok::<_, StudyError>(()))?;
            for (view, found) in report.evaluation.views.iter_mut().zip(&found.views) {
                add(&mut view.scores.perceptual, &found.scores.perceptual);
            }
            add(&mut report.evaluation.perceptual, &found.perceptual);
        }
        if lacks_popping {
            tracing::info!("{}: measuring popping", cell.folder.path().display());
            let measured = Measured::of_scene(&renderer, self.dataset, &scene.info)?;
            report.popping = measured.map(|measured| measured.popping);
            if report.popping.is_none() {
                tracing::warn!("{}: no surface is seen from two frames", cell.folder.path().display());
            }
        }
        Ok(write_json(&path, &report)?)
    }
}

/// The row of a finished `cell`, by the files of its run.
///
/// # Errors
/// [`StudyError::Evaluation`]; if its log cannot be read.
pub fn row(cell: &Cell) -> Result<Row> {
    let report = read(&cell.folder.evaluation())?;
    let mut row = Row::new(cell.variant.label, Some(cell.seed()));
    row.settings.clone_from(&cell.variant.settings);
    row.folder = Some(cell.relative.clone());
    row.set_scores(&report.evaluation.scores());
    row.set_counts(report.evaluation.surfels, report.evaluation.gaussians);
    if cell.folder.validation().is_file() {
        let kept = read(&cell.folder.validation())?.evaluation;
        row.set("validation_psnr", Some(kept.psnr));
        row.set("validation_ssim", Some(kept.ssim));
    }
    row.set("flip_1", report.popping.map(|popping| popping.flip_1));
    row.set("flip_7", report.popping.map(|popping| popping.flip_7));
    let jumps = report.popping.and_then(|popping| popping.jumps);
    row.set("jumps_8", jumps.map(|jumps| jumps.jumps_8));
    row.set("jumps_16", jumps.map(|jumps| jumps.jumps_16));
    row.set("coverage", report.evaluation.coverage);
    row.set("floaters", report.floaters.map(|found| (found.surfels + found.gaussians) as f64));
    row.set("bytes", Some(report.bytes as f64));
    row.set("training_seconds", Some(MetricsLog::seconds_of_steps(&cell.folder.metrics())?));
    row.set("training_peak_bytes", report.peak_memory_bytes.map(|bytes| bytes as f64));
    Ok(row)
}

/// Reads an evaluation of a run.
pub fn read(path: &Path) -> Result<EvalReport> {
    let wrong = |reason: String| StudyError::Evaluation { path: path.to_owned(), reason };
    let text = std::fs::read_to_string(path).map_err(|error| wrong(error.to_string()))?;
    serde_json::from_str(&text).map_err(|error| wrong(error.to_string()))
}

/// Adds what `known` lacks.
fn add(known: &mut Perceptual, found: &Perceptual) {
    known.ms_ssim = known.ms_ssim.or(found.ms_ssim);
    known.ssimulacra2 = known.ssimulacra2.or(found.ssimulacra2);
    known.lpips_alex = known.lpips_alex.or(found.lpips_alex);
    known.lpips_vgg = known.lpips_vgg.or(found.lpips_vgg);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reports_that_cannot_be_read_are_named() {
        let at = tempfile::tempdir().unwrap();
        let path = at.path().join("eval.json");
        std::fs::write(&path, "{}").unwrap();
        let message = read(&path).unwrap_err().to_string();
        assert!(message.contains("eval.json cannot be read: missing field"), "{message}");
    }
}
