//! Progress of a run, and its end by Ctrl-C or a failing device.

use std::sync::atomic::{AtomicBool, Ordering};

use dpges_core::scene::SceneData;
use dpges_train::config::StagePlan;
use dpges_train::device::failure::Watch;
use dpges_train::eval::Evaluation;
use dpges_train::run::{Observer, Run, StepReport, Verdict};

use crate::logging::LogStyle;
use crate::progress::ProgressDisplay;

/// Messages and progress of one run, on standard error.
pub struct Display<'a> {
    progress: ProgressDisplay,
    patience: usize,
    interrupted: &'a AtomicBool,
    watch: Option<Watch>,
    other: &'a mut dyn Observer,
}

impl<'a> Display<'a> {
    /// Stops `run` once `interrupted`, when `watch` sees that the device has failed, or when `other` asks for it, which
    /// hears of everything too.
    pub fn new(
        run: &Run,
        style: LogStyle,
        interrupted: &'a AtomicBool,
        watch: Option<Watch>,
        other: &'a mut dyn Observer,
    ) -> Self {
        let (config, completed) = (run.trainer().config(), run.trainer().completed_steps());
        let progress = ProgressDisplay::new(style, config.total_steps(), completed);
        Self { progress, patience: config.train.patience, interrupted, watch, other }
    }
}

impl Observer for Display<'_> {
    fn step(&mut self, report: &StepReport, seconds: f64) {
        self.progress.step(report, seconds);
        for event in &report.events {
            tracing::info!("step {}: {event}", report.step);
        }
        self.other.step(report, seconds);
    }

    fn evaluated(&mut self, step: usize, evaluation: &Evaluation) {
        let Evaluation { psnr, ssim, flip, views, .. } = evaluation;
        let count = views.len();
        tracing::info!("step {step}: held-out PSNR {psnr:.2} dB, SSIM {ssim:.4}, FLIP {flip:.4} over {count} views");
        self.other.evaluated(step, evaluation);
    }

    fn validated(&mut self, step: usize, psnr: f64, verdict: Verdict) {
        let patience = self.patience;
        match verdict {
            Verdict::Best => tracing::info!("step {step}: validation PSNR {psnr:.2} dB, the best so far"),
            Verdict::Worse { since, best_step, best_psnr } => tracing::info!(
                "step {step}: validation PSNR {psnr:.2} dB, not above the {best_psnr:.2} dB of step {best_step}; \
                 {since} of {patience}"
            ),
            Verdict::Enough { best_step, best_psnr } => tracing::info!(
                "step {step}: validation PSNR {psnr:.2} dB, not above the {best_psnr:.2} dB of step {best_step} for \
                 {patience} evaluations: the run ends with the scene of step {best_step}"
            ),
        }
        self.other.validated(step, psnr, verdict);
    }

    fn stage_ended(&mut self, stage: StagePlan, scene: &SceneData) {
        tracing::info!("stage {stage} is over: {} Gaussians", scene.gaussians.len());
        self.other.stage_ended(stage, scene);
    }

    fn saved(&mut self, step: usize) {
        self.other.saved(step);
    }

    fn wants_scene(&mut self) -> bool {
        self.other.wants_scene()
    }

    fn scene(&mut self, step: usize, scene: SceneData) {
        self.other.scene(step, scene);
    }

    fn should_stop(&mut self) -> bool {
        let asked = self.other.should_stop();
        asked || self.interrupted.load(Ordering::SeqCst)
    }

    fn device_failure(&mut self) -> Option<String> {
        self.watch.as_ref()?.failure().map(|failure| failure.to_string())
    }
}
