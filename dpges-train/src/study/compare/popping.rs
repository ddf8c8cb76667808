//! Popping of the runs of a comparison, which training does not measure.

use std::path::Path;

use dpges_core::scene::SceneData;
use dpges_train::eval::popping::{Popping, arc};
use dpges_train::eval::rendered::Renderer;
use dpges_train::run::folder::{RunFolder, write_json};

use super::super::series::Common;
use super::super::series::row::{Row, read_report};
use crate::cli::Result;

/// Measures popping along the same path for all, and adds it to the `eval.json` of every run that lacks it in the folder
/// `out` of a comparison.
pub fn measure(out: &Path, rows: &[Row], common: &Common) -> Result<()> {
    for run in rows.iter().flat_map(|row| &row.runs).filter(|run| run.popping.is_none()) {
        let folder = RunFolder::new(out.join(&run.folder));
        let scene = SceneData::load(&folder.scene())?;
        let path = arc(&common.dataset, &scene.info)?;
        tracing::info!("{}: measuring popping over {} frames", folder.path().display(), path.len());
        let mut report = read_report(&folder.evaluation())?;
        report.popping = Popping::measure(&Renderer::new(&scene, &common.device), &path)?;
        match report.popping {
            Some(_) => write_json(&folder.evaluation(), &report)?,
            None => tracing::warn!("{}: no surface is seen from two frames", folder.path().display()),
        }
    }
    Ok(())
}
