//! Messages on standard error while a command works.

use std::io::IsTerminal;

use tracing_indicatif::IndicatifLayer;
use tracing_subscriber::EnvFilter;
use tracing_subscriber::fmt::layer;
use tracing_subscriber::layer::SubscriberExt;
use tracing_subscriber::util::SubscriberInitExt;

use super::{Result, print};

/// Variable that replaces the filter, e.g. `DPGES_LOG=debug`.
const FILTER_VARIABLE: &str = "DPGES_LOG";

/// Of dependencies. Looking for adapters tries every graphics API, and wgpu complains of each that is not there.
const OTHERS: &str = "warn,wgpu_hal=off,wgpu_core=error";

/// How progress is shown.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LogStyle {
    /// A progress bar at the bottom of a terminal, messages above it.
    Bar,
    /// Not a terminal: a line every few seconds.
    Lines,
    /// Every message a line of JSON.
    Json,
    /// Warnings and errors only.
    Quiet,
}

impl LogStyle {
    pub fn choose(quiet: bool, json: bool) -> Self {
        match (quiet, json) {
            (true, _) => Self::Quiet,
            (_, true) => Self::Json,
            _ if std::io::stderr().is_terminal() => Self::Bar,
            _ => Self::Lines,
        }
    }

    /// Prints what came out, unless only warnings and errors are wanted.
    pub fn print(self, text: &str) -> Result<()> {
        if self == Self::Quiet { Ok(()) } else { print(text) }
    }
}

/// Starts logging; once per process. One that `follows` another says what went wrong and nothing else.
pub fn init(style: LogStyle, json: bool, follows: bool) {
    let own = if style == LogStyle::Quiet { "" } else { ",dpges=info" };
    let filter = EnvFilter::try_from_env(FILTER_VARIABLE)
        .unwrap_or_else(|_| EnvFilter::new(if follows { "error".to_owned() } else { OTHERS.to_owned() + own }));
    let registry = tracing_subscriber::registry().with(filter);
    if json {
        registry.with(layer().json().flatten_event(true).with_writer(std::io::stderr)).init();
    } else if style == LogStyle::Bar {
        let bars = IndicatifLayer::new();
        let plain = layer().without_time().with_target(false).with_writer(bars.get_stderr_writer());
        registry.with(plain).with(bars).init();
    } else {
        registry.with(layer().without_time().with_target(false).with_ansi(false).with_writer(std::io::stderr)).init();
    }
}
