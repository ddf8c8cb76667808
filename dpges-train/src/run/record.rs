//! Files that a run writes to its folder.

use std::io::Write;
use std::path::Path;

use dpges_core::Result;
use dpges_core::scene::SceneData;
use dpges_core::scene::atomic::write_atomically;

use super::StepReport;
use super::folder::{Origin, RunFolder, RunFolderError, failed, write_json};
use super::metrics_log::MetricsLog;
use crate::config::Config;
use crate::device::memory::PeakMemory;
use crate::eval::floaters::Floaters;
use crate::eval::{EvalReport, Evaluation};
use crate::views::corrections::ViewCorrections;

/// Steps between lines of `metrics.jsonl`.
const METRICS_EVERY: usize = 10;

/// The folder of a run, and its open log.
pub struct Record {
    pub folder: RunFolder,
    origin: Origin,
    pub metrics: MetricsLog,
    /// Peak memory of the run, in this process.
    peak: PeakMemory,
    reported: usize,
}

impl Record {
    /// The record of a run before its first step, in place of another run in the folder; `peak` began with the run.
    pub fn start(folder: RunFolder, origin: Origin, config: &Config, peak: PeakMemory) -> Result<Self, RunFolderError> {
        let folder = folder.held()?;
        folder.start(&origin, config)?;
        let metrics = MetricsLog::create(&folder.metrics())?;
        Ok(Self { folder, origin, metrics, peak, reported: 0 })
    }

    /// The record of a run that goes on after `completed` steps, of a stage that may be over, and the seconds that it had taken by
    /// then; `peak` began where it goes on.
    pub fn resume(
        folder: RunFolder,
        origin: Origin,
        completed: usize,
        stage_is_over: bool,
        peak: PeakMemory,
    ) -> Result<(Self, f64), RunFolderError> {
        let folder = folder.held()?;
        let (metrics, seconds) = MetricsLog::resume(&folder.metrics(), completed, stage_is_over)?;
        Ok((Self { folder, origin, metrics, peak, reported: completed }, seconds))
    }

    /// Logs every tenth step, those with events, and the `last`; `seconds` is the time of the whole run so far.
    pub fn step(&mut self, report: &StepReport, last: bool, seconds: f64) -> Result<()> {
        let before = std::mem::replace(&mut self.reported, report.step);
        if before / METRICS_EVERY < report.step / METRICS_EVERY || !report.events.is_empty() || last {
            self.metrics.step(report, seconds)?;
        }
        Ok(())
    }

    /// Writes `scene` to the file `place`, and beside it the `corrections` of training views that belong to it.
    pub fn save_scene(&self, scene: &SceneData, corrections: &ViewCorrections, place: &Path) -> Result<()> {
        scene.save(place)?;
        let [exposure, poses] = self.folder.corrections_of(place);
        if let Some(found) = &corrections.exposure {
            write_json(&exposure, found)?;
        }
        if let Some(found) = &corrections.poses {
            write_json(&poses, found)?;
        }
        Ok(())
    }

    /// Makes the scene in the file `earlier`, with its corrections, the scene of the run.
    pub fn take(&self, earlier: &Path) -> Result<SceneData> {
        let mut scene = SceneData::load(earlier)?;
        let place = self.folder.scene();
        if let Ok(replaced) = SceneData::load(&place) {
            // it may have been measured since
            scene.info.metres_per_unit = replaced.info.metres_per_unit;
        }
        scene.save(&place)?;
        for (from, to) in self.folder.corrections_of(earlier).iter().zip(self.folder.corrections_of(&place)) {
            if from.is_file() {
                let bytes = std::fs::read(from).map_err(failed("cannot read", from))?;
                write_atomically(&to, |file| file.write_all(&bytes))?;
            }
        }
        Ok(scene)
    }

    /// Writes to `path` how well the scene in the file `scene` shows the views of `split`, as [`EvalReport`] names it.
    pub fn report(
        &self,
        split: &str,
        scene: &Path,
        evaluation: &Evaluation,
        floaters: Option<Floaters>,
        path: &Path,
    ) -> Result<()> {
        let file = std::fs::metadata(scene).map_err(failed("cannot read", scene))?;
        let report = EvalReport {
            scene: scene.display().to_string(),
            dataset: self.origin.dataset.clone(),
            split: split.to_owned(),
            evaluation: evaluation.clone(),
            bytes: file.len(),
            floaters,
            training_seconds: Some(MetricsLog::seconds_of_steps(&self.folder.metrics())?),
            peak_memory_bytes: self.peak.bytes(),
            target: None,
            popping: None,
            frame_ms: None,
        };
        write_json(path, &report)
    }
}
