//! A run from its first step, or the one it was stopped after, to its last.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use burn::tensor::Device;
use dpges_core::scene::SceneData;
use dpges_render::Renderer;
use dpges_train::checkpoint::Checkpoint;
use dpges_train::config::{Config, Stop};
use dpges_train::dataset::Dataset;
use dpges_train::device::DeviceName;
use dpges_train::eval::{EvalReport, Evaluation, evaluate, evaluate_each};
use dpges_train::metrics_log::MetricsLog;
use dpges_train::pictures::{comparison, file_stems, save_png};
use dpges_train::run_folder::{Origin, RunFolder, write_json};
use dpges_train::trainer::{StepReport, TrainError, Trainer, Verdict};

use super::super::data::Split;
use super::super::device_failure::{DeviceFailure, Watch};
use super::super::{Failure, Result, table};
use crate::logging::LogStyle;
use crate::progress::{Progress, Seconds};

/// Steps between lines of `metrics.jsonl`.
const METRICS_EVERY: usize = 10;

/// What the trainer is asked to do; the report of the step whose numbers it then knows.
type Work = fn(&mut Trainer) -> Result<Option<StepReport>, TrainError>;

/// What a run works with besides its configuration.
pub struct Setting {
    pub dataset: Arc<Dataset>,
    pub origin: Origin,
    /// The one that `origin` names.
    pub device: Device,
    pub folder: RunFolder,
    pub style: LogStyle,
}

pub struct Session {
    trainer: Trainer,
    dataset: Arc<Dataset>,
    device: Device,
    /// Of a device that may fail while the run goes on: any but a CPU.
    watch: Option<Watch>,
    origin: Origin,
    folder: RunFolder,
    metrics: MetricsLog,
    style: LogStyle,
    started: Instant,
    /// Completed steps of the checkpoint on disk.
    saved: Option<usize>,
}

impl Session {
    /// Before the first step, in place of any earlier run in the folder.
    pub fn start(setting: Setting, config: Config) -> Result<Self> {
        let trainer = Trainer::new(Arc::clone(&setting.dataset), config.clone(), setting.device.clone())?;
        setting.folder.start(&setting.origin, &config)?;
        let metrics = MetricsLog::create(&setting.folder.metrics())?;
        Self::new(setting, trainer, metrics)
    }

    /// Where `checkpoint` was made.
    pub fn resume(setting: Setting, checkpoint: Checkpoint) -> Result<Self> {
        let completed = checkpoint.completed_steps();
        tracing::info!("resuming after step {completed}");
        let metrics = MetricsLog::resume(&setting.folder.metrics(), completed, checkpoint.stage_is_over())?;
        let trainer = Trainer::resume(Arc::clone(&setting.dataset), checkpoint, setting.device.clone())?;
        Self::new(setting, trainer, metrics)
    }

    fn new(setting: Setting, trainer: Trainer, metrics: MetricsLog) -> Result<Self> {
        let Setting { dataset, origin, device, folder, style } = setting;
        let name = origin.device.parse::<DeviceName>().map_err(Failure::Usage)?;
        let watch = (!name.is_cpu()).then(Watch::start);
        let saved = folder.checkpoint().is_file().then(|| trainer.completed_steps());
        Ok(Self { trainer, dataset, device, watch, origin, folder, metrics, style, started: Instant::now(), saved })
    }

    /// Trains to the end, saving and evaluating on the way; stops after a step once `interrupted`. Returns what came
    /// out, as a table for people.
    pub fn run(mut self, interrupted: &AtomicBool) -> Result<String> {
        let Some(watch) = self.watch.clone() else { return self.train(interrupted) };
        match watch.catch(|| self.train(interrupted)) {
            Ok(result) => result,
            Err(failure) => Err(self.device_failed(&failure)),
        }
    }

    fn train(&mut self, interrupted: &AtomicBool) -> Result<String> {
        let train = self.trainer.config().train.clone();
        let total = self.trainer.config().total_steps();
        let mut progress = Progress::new(self.style, total, self.trainer.completed_steps());
        while !self.trainer.is_finished() {
            if self.trainer.stage_is_over() {
                self.end_stage(&mut progress)?;
            }
            self.work(Trainer::step, &mut progress)?;
            let step = self.trainer.completed_steps();
            let stage_is_over = self.trainer.stage_is_over();
            if is_due(step, train.evaluate_every) && !stage_is_over {
                self.work(Trainer::settle, &mut progress)?;
                self.evaluate(&self.trainer.scene())?;
            }
            if train.stop == Stop::Validation && (is_due(step, train.evaluate_every) || stage_is_over) {
                self.work(Trainer::settle, &mut progress)?;
                self.validate(step, train.patience)?;
            }
            let finished = self.trainer.is_finished();
            let stop = interrupted.load(Ordering::SeqCst) && !finished;
            if is_due(step, train.checkpoint_every) || finished || stop {
                self.work(Trainer::settle, &mut progress)?;
                self.save()?;
            }
            if stop {
                drop(progress);
                return Err(self.interrupted());
            }
        }
        drop(progress);
        let scene = match train.stop {
            Stop::Validation => {
                let best = SceneData::load(&self.folder.best())?;
                best.save(&self.folder.scene())?;
                best
            }
            Stop::Steps => self.trainer.scene(),
        };
        let evaluation = self.evaluate(&scene)?;
        self.finish(&scene, evaluation)
    }

    /// Measures and saves what a stage has made, and begins the next.
    fn end_stage(&mut self, progress: &mut Progress) -> Result<()> {
        self.work(Trainer::settle, progress)?;
        let (stage, scene) = (self.trainer.stage(), self.trainer.scene());
        self.check_device()?;
        let path = self.folder.stage_scene(stage.kind);
        scene.save(&path)?;
        tracing::info!("stage {} is over: {} Gaussians in {}", stage.kind, scene.gaussians.len(), path.display());
        if let Some(evaluation) = self.evaluate(&scene)? {
            write_json(&self.folder.stage_evaluation(stage.kind), &self.report(&path, evaluation)?)?;
        }
        self.trainer.next_stage()?;
        self.save()
    }

    /// Lets the validation views judge the last stage.
    fn validate(&mut self, step: usize, patience: usize) -> Result<()> {
        if self.trainer.stage().end() < self.trainer.config().total_steps() {
            return Ok(());
        }
        let scene = self.trainer.scene();
        self.check_device()?;
        let evaluation = evaluate(&scene, &self.dataset.validation, &self.device)?;
        let seconds = self.seconds();
        self.metrics.validation(step, &evaluation, seconds)?;
        let psnr = evaluation.psnr;
        match self.trainer.validation_mut().observe(step, psnr, patience) {
            Verdict::Best => {
                scene.save(&self.folder.best())?;
                tracing::info!("step {step}: validation PSNR {psnr:.2} dB, the best so far");
            }
            Verdict::Worse { since, best_step, best_psnr } => tracing::info!(
                "step {step}: validation PSNR {psnr:.2} dB, not above the {best_psnr:.2} dB of step {best_step}; \
                 {since} of {patience}"
            ),
            Verdict::Enough { best_step, best_psnr } => tracing::info!(
                "step {step}: validation PSNR {psnr:.2} dB, not above the {best_psnr:.2} dB of step {best_step} for \
                 {patience} evaluations: the run ends with the scene of step {best_step}"
            ),
        }
        Ok(())
    }

    /// Lets the trainer work, then shows and logs the step whose numbers are known by that: on a GPU not the one it
    /// has just begun.
    fn work(&mut self, work: Work, progress: &mut Progress) -> Result<()> {
        let start = Instant::now();
        let known = match work(&mut self.trainer) {
            Ok(known) => known,
            Err(error) => return Err(self.step_failed(&error)),
        };
        self.check_device()?;
        let Some(report) = known else { return Ok(()) };
        progress.step(&report, start.elapsed().as_secs_f64());
        for event in &report.events {
            tracing::info!("step {}: {event}", report.step);
        }
        let last = report.step == self.trainer.config().total_steps();
        if report.step.is_multiple_of(METRICS_EVERY) || !report.events.is_empty() || last {
            let seconds = self.seconds();
            self.metrics.step(&report, seconds)?;
        }
        Ok(())
    }

    /// Of the whole run, over all its resumptions.
    fn seconds(&self) -> f64 {
        self.metrics.seconds_before() + self.started.elapsed().as_secs_f64()
    }

    fn save(&mut self) -> Result<()> {
        let (scene, checkpoint) = (self.trainer.scene(), self.trainer.checkpoint());
        // Read from a device that had failed, they are not to replace those of an earlier step.
        self.check_device()?;
        scene.save(&self.folder.scene())?;
        checkpoint.save(&self.folder.checkpoint())?;
        self.saved = Some(self.trainer.completed_steps());
        Ok(())
    }

    /// Measures the held-out views and writes pictures of a few; `None` if there are none.
    fn evaluate(&mut self, scene: &SceneData) -> Result<Option<Evaluation>> {
        let views = &self.dataset.test;
        if views.is_empty() {
            return Ok(None);
        }
        let step = self.trainer.completed_steps();
        let deterministic = self.trainer.config().train.deterministic;
        let renderer = Renderer::new(scene, &self.device).deterministic(deterministic);
        let stems = file_stems(views);
        let shown = evenly_spaced(self.trainer.config().train.picture_views, views.len());
        let folder = &self.folder;
        let evaluation = evaluate_each(&renderer, scene, views, &self.device, |index, render| {
            if !shown.contains(&index) {
                return Ok(());
            }
            save_png(&comparison(&views[index], render), &folder.picture(step, &stems[index]))
        })?;
        let Evaluation { psnr, ssim, .. } = evaluation;
        tracing::info!("step {step}: held-out PSNR {psnr:.2} dB, SSIM {ssim:.4} over {} views", views.len());
        let seconds = self.seconds();
        self.metrics.evaluation(step, &evaluation, seconds)?;
        Ok(Some(evaluation))
    }

    /// Writes `eval.json` and says what came out.
    fn finish(&self, data: &SceneData, evaluation: Option<Evaluation>) -> Result<String> {
        let scene = self.folder.scene();
        let bytes = std::fs::metadata(&scene)?.len();
        let steps = self.trainer.completed_steps();
        let mut rows = vec![("trained", format!("{steps} steps in {}", Seconds(self.seconds())))];
        let counts = format!("{} surfels, {} Gaussians", data.surfels.len(), data.gaussians.len());
        rows.push(("scene", format!("{counts}, {:.1} MB", bytes as f64 / 1e6)));
        for stage in self.trainer.config().plan() {
            if let Ok(text) = std::fs::read_to_string(self.folder.stage_evaluation(stage.kind)) {
                let report: EvalReport = serde_json::from_str(&text)?;
                let Evaluation { psnr, gaussians, .. } = report.evaluation;
                rows.push(("stage", format!("{}: {psnr:.2} dB with {gaussians} Gaussians", stage.kind)));
            }
        }
        let mut files = vec![scene.display().to_string(), self.folder.metrics().display().to_string()];
        if let Some(evaluation) = evaluation {
            let Evaluation { psnr, ssim, seconds_per_view, .. } = evaluation;
            let views = evaluation.views.len();
            rows.push(("held-out PSNR", format!("{psnr:.2} dB (mean of {views} views)")));
            rows.push(("held-out SSIM", format!("{ssim:.4}")));
            rows.push(("rendering", format!("{:.1} ms per view", 1e3 * seconds_per_view)));
            let report = self.report(&scene, evaluation)?;
            write_json(&self.folder.evaluation(), &report)?;
            files.push(self.folder.evaluation().display().to_string());
            files.push(self.folder.path().join("pictures").display().to_string());
        }
        rows.extend(files.into_iter().enumerate().map(|(index, file)| (if index == 0 { "files" } else { "" }, file)));
        Ok(table(&rows))
    }

    /// What `eval.json` says of the scene in the file `scene`.
    fn report(&self, scene: &Path, evaluation: Evaluation) -> Result<EvalReport> {
        Ok(EvalReport {
            scene: scene.display().to_string(),
            dataset: self.origin.dataset.clone(),
            split: Split::Test.to_string(),
            evaluation,
            bytes: std::fs::metadata(scene)?.len(),
        })
    }

    fn resume_command(&self) -> String {
        let program = std::env::args().next().unwrap_or_else(|| "dpges".to_owned());
        let out = self.folder.path().display().to_string();
        [program.as_str(), "train", "--out", &out, "--resume"].map(quoted).join(" ")
    }

    fn interrupted(&self) -> Failure {
        let (done, all) = (self.trainer.completed_steps(), self.trainer.config().total_steps());
        let message =
            format!("interrupted: step {done} of {all} is done and saved in {}", self.folder.path().display());
        Failure::with_help(message, format!("go on with `{}`", self.resume_command()))
    }

    fn check_device(&self) -> Result<()> {
        match self.watch.as_ref().and_then(Watch::failure) {
            Some(failure) => Err(self.device_failed(&failure)),
            None => Ok(()),
        }
    }

    /// A step that was not taken leaves everything as it was before: that is saved.
    fn step_failed(&mut self, error: &TrainError) -> Failure {
        match error {
            TrainError::Device { reason, .. } => return self.device_failed(&DeviceFailure::new(reason)),
            TrainError::Step { .. } | TrainError::Loss { .. } => {
                if let Err(failure) = self.save() {
                    return failure;
                }
            }
            _ => {}
        }
        Failure::with_help(error, self.way_back())
    }

    /// "Near": a device works behind the program that tells it what to do.
    fn device_failed(&self, failure: &DeviceFailure) -> Failure {
        let step = self.trainer.completed_steps().max(1);
        let message = format!("device `{}` failed near step {step}: {failure}", self.origin.device);
        Failure::with_help(message, format!("{}; {}", self.way_back(), failure.advice()))
    }

    /// How to go on from the last checkpoint.
    fn way_back(&self) -> String {
        match self.saved {
            Some(step) => {
                let path = self.folder.checkpoint();
                format!("{} holds the state after step {step}: `{}`", path.display(), self.resume_command())
            }
            None => "there was no checkpoint yet: train.checkpoint_every says how often".to_owned(),
        }
    }
}

/// True from the first Ctrl-C on; the second ends the process. To be called once in a process.
pub fn watch_for_interrupts() -> Result<Arc<AtomicBool>> {
    let interrupted = Arc::new(AtomicBool::new(false));
    let flag = Arc::clone(&interrupted);
    ctrlc::set_handler(move || {
        if flag.swap(true, Ordering::SeqCst) {
            std::process::exit(1);
        }
        tracing::warn!("finishing this step and saving; Ctrl-C again aborts at once");
    })?;
    Ok(interrupted)
}

fn is_due(step: usize, every: usize) -> bool {
    every > 0 && step.is_multiple_of(every)
}

/// `count` of `0..len`, or all of them.
fn evenly_spaced(count: usize, len: usize) -> Vec<usize> {
    let count = count.min(len);
    (0..count).map(|index| index * len / count).collect()
}

/// As a shell reads it.
fn quoted(word: &str) -> String {
    let plain = |c: char| c.is_alphanumeric() || "-_./:=+,@".contains(c);
    if !word.is_empty() && word.chars().all(plain) {
        word.to_owned()
    } else {
        format!("'{}'", word.replace('\'', r"'\''"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shown_views_are_spread_over_all() {
        assert_eq!(evenly_spaced(3, 7), [0, 2, 4]);
        assert_eq!(evenly_spaced(3, 2), [0, 1]);
        assert_eq!(evenly_spaced(0, 2), [0usize; 0]);
    }

    #[test]
    fn words_are_quoted_where_a_shell_would_split_them() {
        assert_eq!(quoted("runs/first"), "runs/first");
        assert_eq!(quoted("my runs"), "'my runs'");
        assert_eq!(quoted("it's"), r"'it'\''s'");
    }

    #[test]
    fn nothing_is_due_every_zero_steps() {
        assert!(is_due(20, 10) && !is_due(15, 10) && !is_due(10, 0));
    }
}
