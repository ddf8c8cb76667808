//! A run as the command line trains it: shown on the way, and its end in words.

use std::sync::atomic::AtomicBool;

use dpges_train::config::duration::Seconds;
use dpges_train::device::DeviceName;
use dpges_train::device::failure::{DeviceFailure, Watch};
use dpges_train::eval::{EvalReport, Evaluation};
use dpges_train::run::folder::{RunFolder, read_json};
use dpges_train::run::shell::quoted;
use dpges_train::run::{Observer, Outcome, Run, RunError, TrainError};

use super::super::{Failure, Result, table};
use super::display::Display;
use crate::logging::LogStyle;

/// A run that writes to a folder.
pub struct Session {
    pub run: Run,
    /// The one that `run` writes to.
    pub folder: RunFolder,
    /// The one that `run` uses.
    pub device: DeviceName,
    pub style: LogStyle,
}

impl Session {
    /// Trains to the end, or until `interrupted`. Returns what came out, as a table for people. `other` hears of everything too.
    pub fn train(mut self, interrupted: &AtomicBool, other: &mut dyn Observer) -> Result<String> {
        // a CPU does not fail while a run goes on
        let watch = (!self.device.is_cpu()).then(Watch::start);
        let mut display = Display::new(&self.run, self.style, interrupted, watch.clone(), other);
        let result = match watch {
            Some(watch) => watch.catch(|| self.run.train(&mut display)),
            None => Ok(self.run.train(&mut display)),
        };
        drop(display);
        match result {
            Ok(Ok(outcome)) => self.summary(outcome),
            Ok(Err(error)) => Err(self.failure(error)),
            Err(failure) => Err(self.device_failed(&failure)),
        }
    }

    fn summary(&self, outcome: Outcome) -> Result<String> {
        let Outcome { scene, evaluation, seconds } = outcome;
        let path = self.folder.scene();
        let steps = self.run.trainer().completed_steps();
        let mut rows = vec![("trained", format!("{steps} steps in {}", Seconds(seconds)))];
        let counts = format!("{} surfels, {} Gaussians", scene.surfels.len(), scene.gaussians.len());
        rows.push(("scene", format!("{counts}, {:.1} MB", std::fs::metadata(&path)?.len() as f64 / 1e6)));
        for stage in self.run.trainer().plan() {
            // damaged since, it is no reason to fail
            if let Ok(report) = read_json::<EvalReport>(&self.folder.stage_evaluation(stage)) {
                let Evaluation { psnr, gaussians, .. } = report.evaluation;
                rows.push(("stage", format!("{stage}: {psnr:.2} dB with {gaussians} Gaussians")));
            }
        }
        let mut files = vec![path, self.folder.metrics()];
        if let Some(evaluation) = evaluation {
            rows.extend(evaluation.held_out_rows());
            files.extend([self.folder.evaluation(), self.folder.pictures()]);
        }
        let names = std::iter::once("files").chain(std::iter::repeat(""));
        rows.extend(names.zip(files.iter().map(|file| file.display().to_string())));
        Ok(table(&rows))
    }

    fn failure(&self, error: RunError) -> Failure {
        match error {
            RunError::Stopped { step, steps } => {
                let folder = self.folder.path().display();
                let message = format!("interrupted: step {step} of {steps} is done and saved in {folder}");
                Failure::with_help(message, format!("go on with `{}`", self.resume_command()))
            }
            RunError::DiskFull { ref rescued, step, .. } => {
                let after = match rescued {
                    Some(file) => {
                        let [from, to] =
                            [file, &self.folder.checkpoint()].map(|path| quoted(&path.display().to_string()));
                        format!(
                            "the state after step {step} is kept: make room, then `mv {from} {to}` and `{}`",
                            self.resume_command()
                        )
                    }
                    None => format!("make room; {}", self.way_back()),
                };
                Failure::with_help(error, after)
            }
            RunError::Train(TrainError::Device { reason, .. }) => self.device_failed(&DeviceFailure::new(&reason)),
            RunError::Train(error) => Failure::with_help(error, self.way_back()),
            other => other.into(),
        }
    }

    /// The message says "near" because a device lags behind the program that tells it what to do.
    fn device_failed(&self, failure: &DeviceFailure) -> Failure {
        let step = self.run.trainer().completed_steps().max(1);
        let message = format!("device `{}` failed near step {step}: {failure}", self.device);
        Failure::with_help(message, format!("{}; {}", self.way_back(), failure.advice()))
    }

    /// How to go on from the last checkpoint.
    fn way_back(&self) -> String {
        match self.run.saved_step() {
            Some(step) => {
                let single = self.folder.checkpoint();
                let path = if single.is_file() { single } else { self.folder.manifest() };
                format!("{} holds the state after step {step}: `{}`", path.display(), self.resume_command())
            }
            None => "there was no checkpoint yet: train.checkpoint_every says how often".to_owned(),
        }
    }

    fn resume_command(&self) -> String {
        let program = std::env::args().next().unwrap_or_else(|| "dpges".to_owned());
        let out = self.folder.path().display().to_string();
        [program.as_str(), "train", "--out", &out, "--resume"].map(quoted).join(" ")
    }
}
