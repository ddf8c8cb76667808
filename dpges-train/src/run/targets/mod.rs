//! Targets of a run, a time or a speed: a small model of measurements sets its steps or its budget.

mod speed;
mod time;

use std::fmt;
use std::str::FromStr;
use std::sync::Arc;
use std::time::Duration;

use burn::tensor::Device;
use dpges_core::camera::Camera;
use dpges_core::scene::SceneData;
use dpges_render::RenderError;
use serde::{Deserialize, Serialize};

use super::TrainError;
use super::folder::{RunFolder, read_json, write_json};
use super::metrics_log::MetricsLog;
use crate::config::Config;
use crate::config::duration::duration;
use crate::dataset::Dataset;
use crate::eval::{EvalReport, TargetReport};
pub use time::StepTimes;

/// A time or a speed.
#[derive(Clone, Debug, PartialEq)]
pub struct Target {
    wanted: Wanted,
    /// The words of the request.
    text: String,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Wanted {
    /// Length of the training, with what is measured before.
    Time(Duration),
    /// Speed of the real-time renderer.
    FramesPerSecond(f64),
}

/// How a target is reached: the content of `target.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TargetPlan {
    asked: String,
    unit: Unit,
    expected: f64,
    /// The way to the target, in words.
    how: String,
    /// Where frames are measured from, in the coordinates of the scene; empty for other targets.
    cameras: Vec<Camera>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
enum Unit {
    Seconds,
    FramesPerSecond,
}

/// Why a target cannot be reached. Every message says what to ask for instead.
#[derive(Debug, thiserror::Error)]
pub enum TargetError {
    #[error(
        "{asked:.1} s are too short: {measured}; ask for at least {least:.0}s, or train with a smaller --max-resolution"
    )]
    TooShort { asked: f64, measured: String, least: f64 },
    #[error(
        "{adapter} draws {width}x{height} px at most {fastest:.1} times a second, however few the primitives; ask for fewer \
         fps, or train with a smaller --max-resolution"
    )]
    TooFast { adapter: String, width: usize, height: usize, fastest: f64 },
    #[error("{0}; a target in fps is that of the real-time renderer: without an adapter set a --budget")]
    NoAdapter(RenderError),
    #[error(transparent)]
    Render(#[from] RenderError),
    #[error(transparent)]
    Train(#[from] TrainError),
    #[error(transparent)]
    Core(#[from] dpges_core::Error),
}

impl FromStr for Target {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let text = text.trim();
        Ok(Self { wanted: wanted(text)?, text: text.to_owned() })
    }
}

impl fmt::Display for Target {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.text)
    }
}

fn wanted(text: &str) -> Result<Wanted, String> {
    let number = |unit: &str| text.strip_suffix(unit)?.trim().parse::<f64>().ok();
    let megabytes = [("kB", 1e-3), ("MB", 1.0), ("GB", 1e3)].iter().find_map(|(unit, of)| Some(number(unit)? * of));
    match (number("fps"), megabytes) {
        (Some(rate), _) if rate.is_finite() && rate > 0.0 => Ok(Wanted::FramesPerSecond(rate)),
        (Some(_), _) => Err(format!("`{text}` is not a positive, finite number of fps")),
        (None, Some(size)) => Err(format!("`{text}` is a size, which is a budget: write `--budget {size}MB`")),
        (None, None) => duration(text)
            .map(Wanted::Time)
            .map_err(|error| format!("{error}, or a speed of the real-time renderer, such as 30fps")),
    }
}

impl Target {
    /// The options that a target takes the place of, in words.
    pub fn decides(&self) -> Decision {
        match self.wanted {
            Wanted::Time(_) => Decision::Steps,
            Wanted::FramesPerSecond(_) => Decision::Budget,
        }
    }

    /// Changes `config` so that a run on `dataset` and `device` reaches the target. Says what is expected.
    ///
    /// # Errors
    /// If that cannot be, or what is measured fails.
    pub fn plan(
        &self,
        config: &mut Config,
        dataset: &Arc<Dataset>,
        device: &Device,
    ) -> Result<TargetPlan, TargetError> {
        let asked = self.text.clone();
        let plan = match self.wanted {
            Wanted::Time(length) => time::plan(asked, config, dataset, device, length)?,
            Wanted::FramesPerSecond(rate) => speed::plan(asked, config, dataset, device, rate)?,
        };
        tracing::info!("target {self}: {} expected, with {}", plan.unit.text(plan.expected), plan.how);
        Ok(plan)
    }
}

/// The key that a target sets.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Decision {
    /// `train.steps`
    Steps,
    /// `refine.budget`
    Budget,
}

impl Unit {
    fn text(self, value: f64) -> String {
        match self {
            Self::Seconds => format!("{value:.1} s"),
            Self::FramesPerSecond => format!("{value:.1} fps"),
        }
    }

    fn name(self) -> &'static str {
        match self {
            Self::Seconds => "seconds",
            Self::FramesPerSecond => "frames_per_second",
        }
    }
}

impl TargetPlan {
    /// # Errors
    /// [`dpges_core::Error::Io`].
    pub fn save(&self, folder: &RunFolder) -> dpges_core::Result<()> {
        write_json(&folder.target(), self)
    }
}

/// The result of the target of the finished run in `folder`, as text; `None` if it had none. The evaluation of the run
/// contains it too.
///
/// # Errors
/// If a file of the run cannot be read or written, or frames cannot be measured.
pub fn conclude(folder: &RunFolder) -> Result<Option<String>, TargetError> {
    let path = folder.target();
    if !path.is_file() {
        return Ok(None);
    }
    let TargetPlan { asked, unit, expected, cameras, .. } = read_json(&path)?;
    let got = match unit {
        Unit::Seconds => MetricsLog::seconds_of_steps(&folder.metrics())?,
        Unit::FramesPerSecond => speed::frames_per_second(&SceneData::load(&folder.scene())?, &cameras)?,
    };
    let text = format!("{asked}: {} expected, {} reached", unit.text(expected), unit.text(got));
    let evaluation = folder.evaluation();
    if evaluation.is_file() {
        let mut report: EvalReport = read_json(&evaluation)?;
        report.target = Some(TargetReport { asked, unit: unit.name().to_owned(), expected, got });
        write_json(&evaluation, &report)?;
    }
    Ok(Some(text))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Budget;
    use crate::dataset::builtin;
    use crate::run::fixtures::{device, options};

    #[test]
    fn times_and_speeds_are_read_and_sizes_are_budgets() {
        for (text, wanted) in [
            ("5min", Wanted::Time(Duration::from_secs(300))),
            ("90 s", Wanted::Time(Duration::from_secs(90))),
            ("30 fps", Wanted::FramesPerSecond(30.0)),
            ("59.94fps", Wanted::FramesPerSecond(59.94)),
        ] {
            let target: Target = text.parse().unwrap();
            assert_eq!((target.wanted, target.to_string().as_str()), (wanted, text));
        }
        for (text, part) in [
            ("10MB", "write `--budget 10MB`"),
            ("500 kB", "write `--budget 0.5MB`"),
            ("1 GB fps", "s, min or h"),
            ("fast", "s, min or h"),
            ("10", "such as 30fps"),
            ("", "such as 30fps"),
            ("0 fps", "positive"),
            ("NaN fps", "positive"),
            ("0min", "positive"),
        ] {
            let error = text.parse::<Target>().unwrap_err();
            assert!(error.contains(part), "{text}: {error}");
        }
    }

    #[test]
    fn a_time_sets_the_steps_and_is_kept_until_the_end() {
        let (dataset, device) = (Arc::new(builtin(&options(16, [3, 1], 60))), device());
        let mut config = Config::default();
        let mut of = |text: &str| text.parse::<Target>().unwrap().plan(&mut config, &dataset, &device);
        let plan = of("2h").unwrap();
        assert!(plan.expected > 0.8 * 7200.0 && plan.expected <= 7200.0, "{}", plan.expected);
        let error = of("1ms").unwrap_err();
        assert!(error.to_string().contains("too short"), "{error}");
        assert!(config.train.steps > 5000, "{}", config.train.steps);
        assert_eq!(config.refine.budget, Budget::Pixels);

        let at = tempfile::tempdir().unwrap();
        let folder = RunFolder::new(at.path());
        assert_eq!(conclude(&folder).unwrap(), None);
        plan.save(&folder).unwrap();
        std::fs::write(folder.metrics(), "").unwrap();
        let text = conclude(&folder).unwrap().unwrap();
        assert!(text.starts_with("2h: ") && text.ends_with(" s expected, 0.0 s reached"), "{text}");
    }
}
