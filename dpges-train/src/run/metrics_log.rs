//! `metrics.jsonl`: one JSON object per line, appended while a run goes on.
//!
//! | line | content |
//! |---|---|
//! | `{"kind":"step","step":…}` | stage, `loss` and its unweighted terms by name, PSNR (dB), counts and events of one training step |
//! | `{"kind":"evaluation","step":…}` | means over the held-out views |
//! | `{"kind":"validation","step":…}` | means over the views that are kept for decisions |
//!
//! `seconds` is the time trained so far.

use std::fs::{File, OpenOptions};
use std::io::Write;
use std::path::{Path, PathBuf};

use dpges_core::Result;
use dpges_core::scene::atomic::write_atomically;
use serde_json::{Value, json};

use super::folder::failed;
use crate::eval::Evaluation;
use crate::metrics::Fitted;
use crate::stage::StepReport;

/// A log that is open for appending. Every line is handed to the system at once.
#[derive(Debug)]
pub struct MetricsLog {
    file: File,
    path: PathBuf,
}

impl MetricsLog {
    /// An empty log, in place of any other.
    ///
    /// # Errors
    /// [`Error::Io`](dpges_core::Error::Io).
    pub fn create(path: &Path) -> Result<Self> {
        write_atomically(path, |_| Ok(()))?;
        Self::open(path)
    }

    /// The log of a run that goes on after step `completed_steps`, and the seconds that the run had taken by then. Lines
    /// of later steps are dropped, as is a line that was never finished, and the evaluation after `completed_steps` if
    /// it `evaluates_again`: they all come again. A log that is missing starts anew.
    ///
    /// # Errors
    /// [`Error::Io`](dpges_core::Error::Io).
    pub fn resume(path: &Path, completed_steps: usize, evaluates_again: bool) -> Result<(Self, f64)> {
        let text = match std::fs::read_to_string(path) {
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => String::new(),
            text => text.map_err(failed("cannot read", path))?,
        };
        let parsed = |line: &str| serde_json::from_str::<Value>(line).ok();
        let stays = |line: &&str| {
            let Some(line) = parsed(line) else { return false };
            let Some(step) = line["step"].as_u64().map(|step| step as usize) else { return false };
            let comes_again = evaluates_again && step == completed_steps && line["kind"] == "evaluation";
            step <= completed_steps && !comes_again
        };
        let kept: Vec<&str> = text.lines().filter(stays).collect();
        let seconds = kept.last().and_then(|line| parsed(line)?["seconds"].as_f64()).unwrap_or(0.0);
        write_atomically(path, |file| kept.iter().try_for_each(|line| writeln!(file, "{line}")))?;
        Ok((Self::open(path)?, seconds))
    }

    /// Seconds that the run of the log at `path` had taken at its last logged step, evaluations on the way included.
    ///
    /// # Errors
    /// [`Error::Io`](dpges_core::Error::Io).
    pub fn seconds_of_steps(path: &Path) -> Result<f64> {
        let text = std::fs::read_to_string(path).map_err(failed("cannot read", path))?;
        let mut latest_first = text.lines().rev().filter_map(|line| serde_json::from_str::<Value>(line).ok());
        let step = latest_first.find(|line| line["kind"] == "step");
        Ok(step.and_then(|line| line["seconds"].as_f64()).unwrap_or(0.0))
    }

    fn open(path: &Path) -> Result<Self> {
        let file = OpenOptions::new().append(true).open(path).map_err(failed("cannot write", path))?;
        Ok(Self { file, path: path.to_owned() })
    }

    /// Appends a step; `seconds` is the time of the whole run so far.
    ///
    /// # Errors
    /// [`Error::Io`](dpges_core::Error::Io).
    pub fn step(&mut self, report: &StepReport, seconds: f64) -> Result<()> {
        let mut line = json!({
            "kind": "step", "step": report.step, "stage": report.stage.to_string(), "view": report.view,
            "loss": report.loss, "psnr": report.psnr, "surfels": report.surfels, "gaussians": report.gaussians,
            "seconds": seconds,
        });
        for &(term, value) in &report.terms {
            line[term] = json!(value);
        }
        if !report.events.is_empty() {
            line["events"] = json!(report.events);
        }
        self.append(&line)
    }

    /// Appends an evaluation of the held-out views; `seconds` is the time of the whole run so far.
    ///
    /// # Errors
    /// [`Error::Io`](dpges_core::Error::Io).
    pub fn evaluation(&mut self, step: usize, evaluation: &Evaluation, seconds: f64) -> Result<()> {
        let mut line = line_of("evaluation", step, evaluation, seconds);
        line["seconds_per_view"] = json!(evaluation.seconds_per_view);
        self.append(&line)
    }

    /// Appends an evaluation of the validation views; `seconds` is the time of the whole run so far.
    ///
    /// # Errors
    /// [`Error::Io`](dpges_core::Error::Io).
    pub fn validation(&mut self, step: usize, evaluation: &Evaluation, seconds: f64) -> Result<()> {
        self.append(&line_of("validation", step, evaluation, seconds))
    }

    fn append(&mut self, line: &Value) -> Result<()> {
        self.file.write_all(format!("{line}\n").as_bytes()).map_err(failed("cannot write", &self.path))
    }
}

fn line_of(kind: &str, step: usize, evaluation: &Evaluation, seconds: f64) -> Value {
    let mut line = json!({
        "kind": kind, "step": step, "psnr": evaluation.psnr, "ssim": evaluation.ssim, "flip": evaluation.flip,
        "views": evaluation.views.len(), "surfels": evaluation.surfels, "gaussians": evaluation.gaussians,
        "seconds": seconds,
    });
    // only some runs measure these
    let Fitted { psnr_fitted, ssim_fitted, .. } = evaluation.fitted;
    for (key, value) in [("psnr_fitted", psnr_fitted), ("ssim_fitted", ssim_fitted)] {
        if let Some(value) = value {
            line[key] = json!(value);
        }
    }
    line
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Config;

    fn report(step: usize) -> StepReport {
        StepReport {
            step,
            stage: *Config::default().plan(0).last().unwrap(),
            view: 1,
            loss: 0.5,
            terms: vec![("rgb", 0.4), ("surfel", 0.3)],
            psnr: 20.0,
            surfels: 3,
            gaussians: 4,
            events: vec!["2 surfels removed".to_owned()],
        }
    }

    #[test]
    fn resuming_drops_later_and_unfinished_lines_and_keeps_the_clock() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("metrics.jsonl");
        let mut log = MetricsLog::create(&path).unwrap();
        for step in [10, 20, 30] {
            log.step(&report(step), step as f64).unwrap();
        }
        OpenOptions::new().append(true).open(&path).unwrap().write_all(b"{\"kind\":\"st").unwrap();
        let (mut log, seconds) = MetricsLog::resume(&path, 20, false).unwrap();
        assert_eq!(seconds, 20.0);
        log.step(&report(21), 21.0).unwrap();
        let text = std::fs::read_to_string(&path).unwrap();
        let steps: Vec<u64> =
            text.lines().map(|line| serde_json::from_str::<Value>(line).unwrap()["step"].as_u64().unwrap()).collect();
        assert_eq!(steps, [10, 20, 21]);
        assert!(text.contains(r#""rgb":0.4"#) && text.contains(r#""surfel":0.3"#), "{text}");
        let line = r#"{"kind":"evaluation","step":21,"seconds":9}"#;
        OpenOptions::new().append(true).open(&path).unwrap().write_all(line.as_bytes()).unwrap();
        MetricsLog::resume(&path, 21, false).unwrap();
        assert_eq!(MetricsLog::seconds_of_steps(&path).unwrap(), 21.0, "not the evaluation's");
        assert!(std::fs::read_to_string(&path).unwrap().contains("evaluation"));
        MetricsLog::resume(&path, 21, true).unwrap();
        assert!(!std::fs::read_to_string(&path).unwrap().contains("evaluation"));
        std::fs::remove_file(&path).unwrap();
        assert_eq!(MetricsLog::resume(&path, 20, false).unwrap().1, 0.0);
    }
}
