//! What the runs of a series have come to.

use std::path::Path;

use dpges_train::eval::floaters::Floaters;
use dpges_train::eval::popping::Popping;
use dpges_train::eval::{EvalReport, ViewScore};
use dpges_train::metrics::Scores;
use dpges_train::run::folder::RunFolder;
use dpges_train::run::metrics_log::MetricsLog;

use super::statistics::Spread;
use crate::cli::{Failure, Result};

/// What came out of one run.
#[derive(Clone, Debug, PartialEq)]
pub struct Measured {
    pub seed: u64,
    /// Relative to the folder of the series.
    pub folder: String,
    /// Of the held-out views.
    pub test: Scores,
    /// Of the views that were kept for decisions, if there are any.
    pub validation: Option<Scores>,
    pub surfels: usize,
    pub gaussians: usize,
    /// `None` if the dataset does not say which view saw what.
    pub floaters: Option<Floaters>,
    /// `None` unless it was measured.
    pub popping: Option<Popping>,
    /// Size of the scene file.
    pub bytes: u64,
    /// Wall-clock time up to the last step, including evaluations, before and after every resumption.
    pub seconds: f64,
    /// The most memory of the process while it trained, bytes; `None` where that is not known.
    pub peak_memory_bytes: Option<u64>,
    /// The held-out views one by one.
    pub views: Vec<ViewScore>,
}

/// The runs of one configuration, a seed each.
#[derive(Clone, Debug, PartialEq)]
pub struct Row {
    pub label: &'static str,
    /// At least one.
    pub runs: Vec<Measured>,
}

impl Measured {
    /// From the folder of a finished run; `relative` is what it is called in the folder of the series.
    pub fn read(folder: &RunFolder, relative: String, seed: u64) -> Result<Self> {
        let report = read_report(&folder.evaluation())?;
        let path = folder.validation();
        let validation = if path.is_file() { Some(read_report(&path)?.evaluation.scores()) } else { None };
        Ok(Self {
            seed,
            folder: relative,
            test: report.evaluation.scores(),
            validation,
            surfels: report.evaluation.surfels,
            gaussians: report.evaluation.gaussians,
            floaters: report.floaters,
            popping: report.popping,
            bytes: report.bytes,
            seconds: MetricsLog::seconds_of_steps(&folder.metrics())?,
            peak_memory_bytes: report.peak_memory_bytes,
            views: report.evaluation.views,
        })
    }
}

impl Row {
    /// Mean and spread over the seeds.
    pub fn spread(&self, of: impl Fn(&Measured) -> f64) -> Spread {
        Spread::of(&self.values(of))
    }

    /// Mean and spread of the difference to `base`, seed by seed. Both have the same seeds.
    pub fn difference(&self, base: &Self, of: impl Fn(&Measured) -> f64) -> Spread {
        Spread::of_differences(&self.values(&of), &base.values(&of))
    }

    /// Mean and spread over the seeds; `None` if a run has no validation views.
    pub fn validation(&self, of: impl Fn(&Scores) -> f64) -> Option<Spread> {
        self.spread_if_known(|run| run.validation.as_ref().map(&of))
    }

    /// Mean and spread over the seeds; `None` if a run does not have it.
    pub fn spread_if_known(&self, of: impl Fn(&Measured) -> Option<f64>) -> Option<Spread> {
        let values: Option<Vec<f64>> = self.runs.iter().map(of).collect();
        values.map(|values| Spread::of(&values))
    }

    fn values(&self, of: impl Fn(&Measured) -> f64) -> Vec<f64> {
        self.runs.iter().map(of).collect()
    }
}

/// Reads an evaluation of a run.
pub fn read_report(path: &Path) -> Result<EvalReport> {
    let wrong = |error: String| {
        let help = "remove it to finish its run again";
        Failure::with_help(format!("{} cannot be read: {error}", path.display()), help)
    };
    let text = std::fs::read_to_string(path).map_err(|error| wrong(error.to_string()))?;
    serde_json::from_str(&text).map_err(|error| wrong(error.to_string()))
}

#[cfg(test)]
pub mod tests {
    use dpges_train::metrics::{Fitted, Perceptual};

    use super::*;

    /// Without further measures.
    pub fn scores(psnr: f64, ssim: f64, flip: f64) -> Scores {
        Scores { psnr, ssim, flip, perceptual: Perceptual::default(), fitted: Fitted::default() }
    }

    /// A row with seeds 0, 1, …, and a PSNR for each.
    pub fn row(label: &'static str, psnr: &[f64]) -> Row {
        let measured = |(seed, &psnr): (usize, &f64)| Measured {
            seed: seed as u64,
            folder: format!("{label}/seed_{seed}"),
            test: scores(psnr, 0.75, 0.125),
            validation: None,
            surfels: 12,
            gaussians: 345 + 2 * seed,
            floaters: None,
            popping: None,
            bytes: 6_700_000,
            seconds: 89.04,
            peak_memory_bytes: None,
            views: Vec::new(),
        };
        Row { label, runs: psnr.iter().enumerate().map(measured).collect() }
    }

    #[test]
    fn validation_is_known_if_it_is_of_every_run() {
        let mut row = row("a", &[20.0, 30.0]);
        assert_eq!(row.validation(|scores| scores.psnr), None);
        row.runs[0].validation = Some(scores(10.0, 0.5, 0.25));
        assert_eq!(row.validation(|scores| scores.psnr), None);
        row.runs[1].validation = Some(scores(14.0, 0.5, 0.25));
        assert_eq!(row.validation(|scores| scores.psnr).unwrap().mean, 12.0);
    }

    #[test]
    fn reports_that_cannot_be_read_are_named() {
        let at = tempfile::tempdir().unwrap();
        let folder = RunFolder::new(at.path());
        std::fs::write(folder.evaluation(), "{}").unwrap();
        let Err(Failure::Failed(report)) = Measured::read(&folder, String::new(), 0) else { panic!("it is read") };
        assert!(report.to_string().contains("eval.json cannot be read: missing field"), "{report}");
    }
}
