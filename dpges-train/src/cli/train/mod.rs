//! `dpges train`: from photographs to a scene.

mod session;

use std::path::{Path, PathBuf};
use std::sync::Arc;

use burn::tensor::Device;
use clap::Args;
use dpges_train::checkpoint::Checkpoint;
use dpges_train::config::Config;
use dpges_train::device::DeviceName;
use dpges_train::metrics_log::MetricsLog;
use dpges_train::run_folder::{Origin, RunFolder, RunFolderError};
use dpges_train::trainer::Trainer;
use toml::Table;

use super::data::{DataArgs, Source};
use super::{Failure, Result};
use crate::logging::LogStyle;
use session::Session;

/// What the built-in scene is trained with unless a preset or a configuration file is named: about two minutes.
const BUILTIN_DEFAULTS: [&str; 4] =
    ["train.steps=2000", "train.evaluate_every=500", "train.checkpoint_every=500", "refine.surfel_min_pixels=1"];

/// Train a scene from photographs with known cameras
///
/// Without DATASET a small built-in scene is trained, in about two minutes on two cores; unless --preset or --config
/// is given, its defaults are 2000 steps and an evaluation and a checkpoint every 500.
///
/// Options win over --set, --set over --config, --config over --preset, --preset over the defaults.
#[derive(Debug, Args)]
#[command(after_help = "Ctrl-C finishes the step, saves a checkpoint and says how to go on; a second one aborts.")]
pub struct TrainArgs {
    /// Folder of a COLMAP, Blender or nerfstudio dataset, or `builtin`
    dataset: Option<PathBuf>,
    /// Folder of the run [default: runs/NAME OF THE DATASET]
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// cpu, cpu-flex, wgpu (the best GPU), or what else `dpges devices` lists [default: cpu]
    #[arg(long, value_name = "NAME")]
    device: Option<DeviceName>,
    /// Length of the run, one view per step
    #[arg(long, value_name = "N")]
    steps: Option<usize>,
    /// Of everything random
    #[arg(long, value_name = "S")]
    seed: Option<u64>,
    /// Fix the order of sums on GPUs, so that two runs give the same file; on CPUs it always is
    #[arg(long)]
    deterministic: bool,
    /// Configuration that comes with the program, such as cpu
    #[arg(long, value_name = "NAME")]
    preset: Option<String>,
    /// Configuration file (TOML)
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Any key of the configuration, such as refine.budget=50000; may be repeated
    #[arg(long, value_name = "KEY=VALUE")]
    set: Vec<String>,
    /// Most surfels and Gaussians together
    #[arg(long, value_name = "N")]
    budget: Option<usize>,
    #[command(flatten)]
    data: DataArgs,
    /// Go on from the checkpoint in the run's folder
    #[arg(long, conflicts_with = "overwrite")]
    resume: bool,
    /// Replace the run in the folder
    #[arg(long)]
    overwrite: bool,
}

pub fn run(args: TrainArgs, style: LogStyle) -> Result<()> {
    let session = if args.resume { args.resume(style)? } else { args.start(style)? };
    session.run()
}

impl TrainArgs {
    fn source(&self) -> Source {
        self.dataset.as_deref().map_or(Source::Builtin, Source::new).absolute()
    }

    fn folder(&self) -> RunFolder {
        let named = || match self.source() {
            Source::Folder(path) => Path::new("runs").join(path.file_name().unwrap_or_else(|| "dataset".as_ref())),
            Source::Builtin => PathBuf::from("runs/builtin"),
        };
        RunFolder::new(&self.out.clone().unwrap_or_else(named))
    }

    /// What was asked for: the configuration made of `file` instead of --config where there is one.
    fn resolve(&self, source: &Source, file: Option<&Path>) -> Result<Config> {
        let bare = self.preset.is_none() && self.config.is_none() && file.is_none();
        let defaults: &[&str] = if bare && *source == Source::Builtin { &BUILTIN_DEFAULTS } else { &[] };
        let mut set: Vec<String> = defaults.iter().map(|&text| text.to_owned()).collect();
        set.extend(self.set.clone());
        set.extend(self.data.assignments());
        set.extend(self.steps.map(|steps| format!("train.steps={steps}")));
        set.extend(self.seed.map(|seed| format!("train.seed={seed}")));
        set.extend(self.deterministic.then(|| "train.deterministic=true".to_owned()));
        set.extend(self.budget.map(|budget| format!("refine.budget={budget}")));
        let file = file.or(self.config.as_deref());
        Config::resolve(self.preset.as_deref(), file, &set).map_err(Failure::from_config)
    }

    fn start(self, style: LogStyle) -> Result<Session> {
        let source = self.source();
        let config = self.resolve(&source, None)?;
        let folder = self.folder();
        if !self.overwrite {
            folder.check_unused().map_err(|error| {
                Failure::with_help(error, "go on with it (--resume), replace it (--overwrite), or name another --out")
            })?;
        }
        let device = match self.device {
            Some(device) => device,
            None => "cpu".parse().map_err(Failure::Usage)?,
        };
        let opened = open(device)?;
        let dataset = Arc::new(source.load(&config.data)?);
        let trainer = Trainer::new(Arc::clone(&dataset), config.clone(), opened)?;
        let origin = Origin {
            dataset: source.to_string(),
            device: device.to_string(),
            version: env!("CARGO_PKG_VERSION").to_owned(),
        };
        folder.start(&origin, &config)?;
        let metrics = MetricsLog::create(&folder.metrics())?;
        Session::new(trainer, dataset, origin, folder, metrics, style)
    }

    fn resume(self, style: LogStyle) -> Result<Session> {
        let folder = self.folder();
        folder.check_resumable().map_err(|error| {
            Failure::with_help(error, "name the folder of a run with --out, or start one without --resume")
        })?;
        let checkpoint = Checkpoint::load(&folder.checkpoint())?;
        let mut origin = folder.read_origin().map_err(|error: RunFolderError| {
            Failure::with_help(error, "the folder is not complete: train anew into another one")
        })?;
        if self.dataset.is_some() && self.source().to_string() != origin.dataset {
            let (asked, trained) = (self.source(), &origin.dataset);
            return Err(Failure::Usage(format!("the run to resume was trained on {trained}, not on {asked}")));
        }
        let source = Source::new(Path::new(&origin.dataset));
        folder.write_config(checkpoint.config())?;
        let complete = self.preset.is_some() || self.config.is_some();
        let file = (!complete).then(|| folder.config());
        let asked = self.resolve(&source, file.as_deref())?;
        let differences = differences(checkpoint.config(), &asked);
        if !differences.is_empty() {
            let list = differences.join(", ");
            return Err(Failure::Usage(format!("a run is resumed with the configuration it was started with: {list}")));
        }
        let device = match self.device {
            Some(device) => device,
            None => origin.device.parse().map_err(Failure::Usage)?,
        };
        if device.to_string() != origin.device {
            tracing::warn!(
                "resuming on {device} what was started on {}: the result will differ a little",
                origin.device
            );
            origin.device = device.to_string();
        }
        let opened = open(device)?;
        tracing::info!("resuming after step {}", checkpoint.completed_steps());
        let dataset = Arc::new(source.load(&checkpoint.config().data)?);
        let completed = checkpoint.completed_steps();
        let metrics = MetricsLog::resume(&folder.metrics(), completed, completed >= checkpoint.config().train.steps)?;
        let trainer = Trainer::resume(Arc::clone(&dataset), checkpoint, opened)?;
        Session::new(trainer, dataset, origin, folder, metrics, style)
    }
}

/// The device, before anything is read for it; says which adapter a GPU's name stands for.
fn open(device: DeviceName) -> Result<Device> {
    let opened = device.open()?;
    if !device.is_cpu() {
        tracing::info!("device {device}: {}", device.describe()?);
    }
    Ok(opened)
}

/// Keys whose value in `found` is not that in `expected`.
fn differences(expected: &Config, found: &Config) -> Vec<String> {
    let table = |config: &Config| config.to_toml().parse::<Table>().unwrap_or_default();
    let (expected, found) = (table(expected), table(found));
    let mut differences = Vec::new();
    for (section, keys) in &expected {
        for (key, value) in keys.as_table().into_iter().flatten() {
            let asked = found.get(section).and_then(|keys| keys.get(key));
            if let Some(asked) = asked.filter(|asked| *asked != value) {
                differences.push(format!("`{section}.{key}` is {value}, not {asked}"));
            }
        }
    }
    differences
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn differences_name_the_keys() {
        let mut other = Config::default();
        other.train.steps = 7;
        assert_eq!(differences(&Config::default(), &other), ["`train.steps` is 5000, not 7"]);
        assert!(differences(&other, &other).is_empty());
    }
}
