//! How far a run is: a bar, lines of text or JSON, or nothing.

use std::time::{Duration, Instant};

use dpges_train::config::duration::Seconds;
use dpges_train::run::StepReport;
use indicatif::ProgressStyle;
use tracing::Span;
use tracing_indicatif::span_ext::IndicatifSpanExt;

use crate::logging::LogStyle;

const TEMPLATE: &str = "{wide_bar} {pos}/{len}\n{msg}";
const REDRAW: Duration = Duration::from_millis(100);
const LINE: Duration = Duration::from_secs(5);
/// Weight of the previous value when a smoothed value takes the next.
const MEMORY: f64 = 0.98;

/// Mean over about 50 steps.
#[derive(Default)]
struct Smoothed {
    sum: f64,
    weight: f64,
}

impl Smoothed {
    fn add(&mut self, value: f64) {
        self.sum = MEMORY * self.sum + (1.0 - MEMORY) * value;
        self.weight = MEMORY * self.weight + (1.0 - MEMORY);
    }

    fn get(&self) -> f64 {
        self.sum / self.weight.max(f64::MIN_POSITIVE)
    }
}

/// A bar on a terminal; elsewhere only a clock, which says when the next line is due.
pub struct Progress {
    style: LogStyle,
    span: Span,
    shown: Option<Instant>,
}

impl Progress {
    /// `done` of `total` at first.
    pub fn new(style: LogStyle, done: usize, total: usize) -> Self {
        let span = if style == LogStyle::Bar { tracing::info_span!("progress") } else { Span::none() };
        span.pb_set_style(&ProgressStyle::with_template(TEMPLATE).expect("a valid template"));
        span.pb_set_length(total as u64);
        span.pb_set_position(done as u64);
        span.pb_start();
        Self { style, span, shown: None }
    }

    /// Text below the bar.
    pub fn message(&self, text: &str) {
        self.span.pb_set_message(text);
    }

    /// Returns the style if the text, or the next line, is due.
    pub fn step(&mut self, done: usize, total: usize) -> Option<LogStyle> {
        self.span.pb_set_length(total as u64);
        self.span.pb_set_position(done as u64);
        let pause = if self.style == LogStyle::Bar { REDRAW } else { LINE };
        if self.style == LogStyle::Quiet || self.shown.is_some_and(|shown| shown.elapsed() < pause) {
            return None;
        }
        self.shown = Some(Instant::now());
        Some(self.style)
    }
}

/// Progress of one run, on standard error.
pub struct ProgressDisplay {
    progress: Progress,
    steps: usize,
    loss: Smoothed,
    psnr: Smoothed,
    seconds_per_step: Smoothed,
}

impl ProgressDisplay {
    /// The progress of a run of `steps` steps, of which `completed` are done.
    pub fn new(style: LogStyle, steps: usize, completed: usize) -> Self {
        let (loss, psnr, seconds_per_step) = Default::default();
        Self { progress: Progress::new(style, completed, steps), steps, loss, psnr, seconds_per_step }
    }

    /// Shows a step that took `seconds`.
    pub fn step(&mut self, report: &StepReport, seconds: f64) {
        self.loss.add(report.loss);
        self.psnr.add(report.psnr);
        self.seconds_per_step.add(seconds);
        let steps = self.steps;
        let StepReport { step, stage, surfels, gaussians, .. } = *report;
        let Some(style) = self.progress.step(step, steps) else { return };
        let steps_per_second = 1.0 / self.seconds_per_step.get().max(1e-9);
        let seconds_left = (steps - step) as f64 / steps_per_second;
        let (loss, psnr) = (self.loss.get(), self.psnr.get());
        if style == LogStyle::Json {
            let stage = stage.to_string();
            tracing::info!(step, steps, stage, steps_per_second, loss, psnr, surfels, gaussians, seconds_left);
            return;
        }
        let state = format!(
            "{stage} · {steps_per_second:.1} steps/s · loss {loss:.4} · PSNR {psnr:.2} dB · {surfels} surfels · {gaussians} \
             Gaussians · {} left",
            Seconds(seconds_left)
        );
        if style == LogStyle::Lines {
            tracing::info!("step {step}/{steps}: {state}");
        }
        self.progress.message(&state);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn smoothing_starts_at_the_first_value() {
        let mut value = Smoothed::default();
        value.add(4.0);
        assert!((value.get() - 4.0).abs() < 1e-12);
        value.add(8.0);
        assert!(value.get() > 5.9 && value.get() < 6.1);
    }
}
