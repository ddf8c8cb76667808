//! Several configurations, each trained with one or more seeds on the same data: what studies over many runs share.
//!
//! Each run is in `OUT/LABEL/seed_SEED`. Runs that are finished are skipped, interrupted ones go on, and a folder that
//! holds another run is refused.

pub mod chart;
pub mod entry;
pub mod preset;
pub mod row;
pub mod statistics;

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use burn::tensor::Device;
use clap::{Args, value_parser};
use dpges_train::config::Config;
use dpges_train::dataset::Dataset;
use dpges_train::device::{DeviceName, DeviceRequest};

use crate::cli::data::Source;
use crate::cli::logging::LogStyle;
use crate::cli::train::display::watch_for_interrupts;
use crate::cli::train::options::ConfigArgs;
use crate::cli::{Failure, Result, device_choice, sfm};
use entry::Entry;
use row::Row;

/// Options that all series have.
#[derive(Debug, Args)]
pub struct SeriesArgs {
    /// Folder of a COLMAP, Blender or nerfstudio dataset, or `builtin`; or photographs or a video, see `dpges sfm`
    dataset: Option<PathBuf>,
    /// Folder for the runs and the comparison
    #[arg(long, value_name = "DIR", required_unless_present = "list")]
    out: Option<PathBuf>,
    /// auto (a GPU that passes a check, or else the CPU), cpu, cpu-flex, wgpu (the best GPU), or another one that
    /// `dpges devices` lists
    #[arg(long, value_name = "NAME", default_value_t)]
    device: DeviceRequest,
    /// Number of runs of each: with the seed of the configuration, and with those that follow it
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = value_parser!(u64).range(1..=1000))]
    seeds: u64,
    #[command(flatten)]
    pub options: ConfigArgs,
}

/// One of the configurations of a series.
pub struct Member {
    /// Also the name of its folder.
    pub label: &'static str,
    /// `key=value` of what distinguishes it.
    pub settings: Vec<String>,
}

/// What all runs of a series share.
pub struct Common {
    pub source: Source,
    pub dataset: Arc<Dataset>,
    pub name: DeviceName,
    pub device: Device,
    pub style: LogStyle,
    /// True from the first Ctrl-C on.
    pub interrupted: Arc<AtomicBool>,
}

/// Runs of each member with each seed.
pub struct Series {
    labels: Vec<&'static str>,
    /// All members with the first seed, then with the second, and so on.
    runs: Vec<Entry>,
}

impl SeriesArgs {
    pub fn source(&self) -> Source {
        Source::named(self.dataset.as_deref())
    }

    /// Where the runs and the comparison go.
    pub fn out(&self) -> &Path {
        self.out.as_deref().unwrap_or(Path::new("."))
    }

    /// The configuration for the first seed, with `more` (`key=value`) on top.
    pub fn config(&self, source: &Source, more: &[String]) -> Result<Config> {
        self.options.resolve(source, more)
    }

    /// The runs of `members`. Folders that hold anything else are refused here, before the first step.
    pub fn series(&self, source: &Source, members: &[Member]) -> Result<Series> {
        let first = self.config(source, &[])?.train.seed;
        let mut runs = Vec::new();
        for seed in (first..).take(self.seeds as usize) {
            let seed = format!("train.seed={seed}");
            for member in members {
                let config = self.config(source, &[&member.settings[..], std::slice::from_ref(&seed)].concat())?;
                runs.push(Entry::new(member.label, config, self.out(), source, self.seeds > 1)?);
            }
        }
        Ok(Series { labels: members.iter().map(|member| member.label).collect(), runs })
    }

    /// The device and the data, read as `config` says. There are held-out views among them.
    pub fn load(&self, source: Source, config: &Config, style: LogStyle) -> Result<Common> {
        let name = device_choice::select(self.device)?;
        sfm::prepare(self.dataset.as_deref(), &self.options.sfm(config), style)?;
        let device = name.open()?;
        let dataset = Arc::new(source.load_for_training(config)?);
        if dataset.test.is_empty() {
            let help = "hold out views with --test-every";
            return Err(Failure::with_help(format!("{source} has no held-out views to compare runs on"), help));
        }
        Ok(Common { source, dataset, name, device, style, interrupted: watch_for_interrupts()? })
    }
}

impl Series {
    pub fn is_finished(&self) -> bool {
        self.runs.iter().all(Entry::is_finished)
    }

    /// The configuration of the first member with its first seed.
    pub fn first_config(&self) -> &Config {
        &self.runs[0].config
    }

    /// Trains what is left, if all of it can be.
    pub fn train(&self, common: &Common) -> Result<()> {
        self.runs.iter().try_for_each(|run| run.check(common))?;
        self.runs.iter().try_for_each(|run| run.train(common))
    }

    /// The results, a row for each member.
    pub fn rows(&self) -> Result<Vec<Row>> {
        let row = |&label: &&'static str| {
            let runs = self.runs.iter().filter(|run| run.label == label).map(Entry::measured);
            Ok(Row { label, runs: runs.collect::<Result<_>>()? })
        };
        self.labels.iter().map(row).collect()
    }
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;

    #[derive(Debug, Parser)]
    struct Command {
        #[command(flatten)]
        series: SeriesArgs,
        #[arg(long)]
        list: bool,
    }

    fn series(arguments: &[&str]) -> Result<Series> {
        let out = tempfile::tempdir().unwrap();
        let at = ["series", "--out", out.path().to_str().unwrap()];
        let command = Command::try_parse_from([&at[..], arguments].concat()).unwrap();
        let member = |label, set: &str| Member { label, settings: vec![set.to_owned()] };
        let members = [member("a", "model.layers=1"), member("b", "model.layers=2")];
        command.series.series(&Source::Builtin, &members)
    }

    #[test]
    fn seeds_follow_that_of_the_configuration_and_change_nothing_else() {
        let series = series(&["--seeds=2", "--seed=7", "--steps=9"]).unwrap();
        let found: Vec<(String, u64, usize)> =
            series.runs.iter().map(|run| (run.relative(), run.config.train.seed, run.config.model.layers)).collect();
        let expected = [("a/seed_7", 7, 1), ("b/seed_7", 7, 2), ("a/seed_8", 8, 1), ("b/seed_8", 8, 2)];
        assert_eq!(found, expected.map(|(folder, seed, layers)| (folder.to_owned(), seed, layers)));
        let mut second = series.runs[2].config.clone();
        second.train.seed = 7;
        assert_eq!(second, *series.first_config());
    }

    #[test]
    fn there_are_no_seeds_beyond_the_largest() {
        let largest = format!("--seed={}", i64::MAX);
        assert_eq!(series(&[&largest]).unwrap().runs.len(), 2);
        let Err(Failure::Usage(message)) = series(&[&largest, "--seeds=2"]) else { panic!("not refused") };
        assert!(message.contains("`train.seed`"), "{message}");
        let none = Command::try_parse_from(["series", "--out=a", "--seeds=0"]).unwrap_err();
        assert!(none.to_string().contains("--seeds"), "{none}");
    }
}
