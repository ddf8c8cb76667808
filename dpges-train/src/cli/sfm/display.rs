//! What is shown while the programs work.

use std::time::{Duration, Instant};

use dpges_train::dataset::capture::{Observer, Step};
use indicatif::ProgressStyle;
use tracing::Span;
use tracing_indicatif::span_ext::IndicatifSpanExt;

use crate::cli::logging::LogStyle;
use crate::cli::progress::Seconds;

const TEMPLATE: &str = "{wide_bar} {pos}/{len}\n{msg}";
const LINE: Duration = Duration::from_secs(5);

/// Messages and progress on standard error.
pub struct Display {
    style: LogStyle,
    span: Span,
    shown: Option<Instant>,
}

impl Display {
    pub fn new(style: LogStyle) -> Self {
        Self { style, span: Span::none(), shown: None }
    }
}

/// What happens in a step.
fn about(step: Step) -> &'static str {
    match step {
        Step::Pictures => "taking the pictures",
        Step::Features => "looking for features",
        Step::Matches => "comparing pairs of photographs",
        Step::Mapping => "placing the cameras",
        Step::Model => "taking the largest model",
    }
}

impl Observer for Display {
    fn begin(&mut self, step: Step) {
        self.shown = Some(Instant::now());
        if self.style == LogStyle::Bar {
            self.span = tracing::info_span!("sfm");
            self.span.pb_set_style(&ProgressStyle::with_template(TEMPLATE).expect("a valid template"));
            self.span.pb_set_message(&format!("{step}: {}", about(step)));
            self.span.pb_set_length(1);
            self.span.pb_start();
        } else {
            tracing::info!("{step}: {}", about(step));
        }
    }

    fn progress(&mut self, step: Step, done: usize, total: usize) {
        self.span.pb_set_length(total as u64);
        self.span.pb_set_position(done as u64);
        if self.style == LogStyle::Bar || self.shown.is_some_and(|shown| shown.elapsed() < LINE) {
            return;
        }
        self.shown = Some(Instant::now());
        if self.style == LogStyle::Json {
            let step = step.name();
            tracing::info!(step, done, total);
        } else {
            tracing::info!("{step}: {done} of {total}");
        }
    }

    fn end(&mut self, step: Step, seconds: f64) {
        self.span = Span::none();
        tracing::info!("{step}: done in {}", Seconds(seconds));
    }

    fn warn(&mut self, message: &str) {
        tracing::warn!("{message}");
    }
}
