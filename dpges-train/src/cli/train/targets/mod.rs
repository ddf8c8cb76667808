//! `dpges train --target`: a size, a time or a speed that a run is to reach, by a small model of what is measured.

mod asked;
mod plan;
mod size;
mod speed;
mod time;

use std::sync::Arc;

use burn::tensor::Device;
use dpges_core::scene::SceneData;
use dpges_train::config::Config;
use dpges_train::dataset::Dataset;
use dpges_train::eval::{EvalReport, TargetReport};
use dpges_train::run::folder::{RunFolder, write_json};
use dpges_train::run::metrics_log::MetricsLog;
use serde::{Deserialize, Serialize};

use super::super::{Failure, Result, table};
use super::options::ConfigArgs;
pub use asked::Target;
use asked::Wanted;
use plan::Plan;

/// The content of `target.json`.
#[derive(Debug, PartialEq, Serialize, Deserialize)]
pub struct Pursuit {
    asked: String,
    #[serde(flatten)]
    plan: Plan,
}

impl Target {
    /// Changes `config` so that a run on `dataset` and `device` reaches the target. Says what is expected.
    ///
    /// # Errors
    /// If that cannot be.
    pub fn pursue(&self, config: &mut Config, dataset: &Arc<Dataset>, device: &Device) -> Result<Pursuit> {
        let plan = match self.wanted {
            Wanted::Bytes(bytes) => size::plan(config, bytes)?,
            Wanted::Time(length) => time::plan(config, dataset, device, length)?,
            Wanted::FramesPerSecond(asked) => speed::plan(config, dataset, device, asked)?,
        };
        tracing::info!("target {self}: {} expected, with {}", plan.written(plan.expected), plan.how);
        Ok(Pursuit { asked: self.to_string(), plan })
    }

    /// # Errors
    /// If `options` set what the target decides.
    pub fn check(&self, options: &ConfigArgs) -> Result<()> {
        let taken = match self.wanted {
            Wanted::Bytes(_) | Wanted::FramesPerSecond(_) if options.names_budget() => "--budget",
            Wanted::Time(_) if options.names_length() => "--steps and --steps-scale",
            _ => return Ok(()),
        };
        Err(Failure::Usage(format!("--target {self} decides what {taken} would: leave one of them out")))
    }
}

impl Pursuit {
    /// Keeps it in the folder of the run.
    pub fn save(&self, folder: &RunFolder) -> Result<()> {
        Ok(write_json(&folder.target(), self)?)
    }
}

/// What became of the target of the finished run in `folder`, as text; empty if it had none. The evaluation of the run
/// says it too.
pub fn conclude(folder: &RunFolder) -> Result<String> {
    let path = folder.target();
    if !path.is_file() {
        return Ok(String::new());
    }
    let Pursuit { asked, plan } = serde_json::from_str(&std::fs::read_to_string(&path)?)?;
    let got = match plan.unit.as_str() {
        "bytes" => std::fs::metadata(folder.scene())?.len() as f64,
        "seconds" => MetricsLog::seconds_of_steps(&folder.metrics())?,
        _ => speed::frames_per_second(&SceneData::load(&folder.scene())?, &plan.cameras)?,
    };
    let row = format!("{asked}: {} expected, {} reached", plan.written(plan.expected), plan.written(got));
    let evaluation = folder.evaluation();
    if evaluation.is_file() {
        let mut report: EvalReport = serde_json::from_str(&std::fs::read_to_string(&evaluation)?)?;
        report.target = Some(TargetReport { asked, unit: plan.unit, expected: plan.expected, got });
        write_json(&evaluation, &report)?;
    }
    Ok(table(&[("target", row)]))
}

#[cfg(test)]
mod tests {
    use dpges_train::config::Budget;
    use dpges_train::dataset::{BuiltinOptions, builtin};
    use dpges_train::device::DeviceName;

    use super::*;

    fn small() -> (Arc<Dataset>, Device) {
        let options =
            BuiltinOptions { width: 16, height: 16, train_views: 3, test_views: 1, points: 60, ..Default::default() };
        (Arc::new(builtin(&options)), "cpu".parse::<DeviceName>().unwrap().open().unwrap())
    }

    #[test]
    fn a_size_sets_the_budget_and_a_time_the_steps() {
        let (dataset, device) = small();
        let mut config = Config::default();
        let pursuit = "50kB".parse::<Target>().unwrap().pursue(&mut config, &dataset, &device).unwrap();
        // (50,000 − 4096) / 105
        assert_eq!(config.refine.budget, Budget::Primitives(437));
        assert!(pursuit.plan.expected <= 5e4 && pursuit.plan.written(pursuit.plan.expected) == "0.05 MB");
        assert_eq!(config.train.steps, 5000);

        let pursuit = "2h".parse::<Target>().unwrap().pursue(&mut config, &dataset, &device).unwrap();
        assert!(config.train.steps > 5000, "{}", config.train.steps);
        let expected = pursuit.plan.expected;
        assert!(expected > 0.8 * 7200.0 && expected <= 7200.0, "{expected}");
        assert_eq!(config.refine.budget, Budget::Primitives(437));
        let Err(Failure::Failed(report)) = "0.001s".parse::<Target>().unwrap().pursue(&mut config, &dataset, &device)
        else {
            panic!("not refused")
        };
        assert!(report.to_string().contains("too short"), "{report}");
    }

    #[test]
    fn what_was_expected_is_kept_until_the_end() {
        let at = tempfile::tempdir().unwrap();
        let folder = RunFolder::new(at.path());
        assert_eq!(conclude(&folder).unwrap(), "");
        let (dataset, device) = small();
        let pursuit = "50kB".parse::<Target>().unwrap().pursue(&mut Config::default(), &dataset, &device).unwrap();
        pursuit.save(&folder).unwrap();
        std::fs::write(folder.scene(), vec![0; 45_000]).unwrap();
        let text = conclude(&folder).unwrap();
        assert_eq!(text, "target  50kB: 0.05 MB expected, 0.04 MB reached\n");
    }
}
