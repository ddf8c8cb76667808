//! Options from which the configuration of a run is made.

use std::path::{Path, PathBuf};

use clap::Args;
use dpges_train::config::stages::factor;
use dpges_train::config::{Config, key};
use dpges_train::dataset::capture::Options;

use super::super::Result;
use super::super::data::{DataArgs, Source, absolute, assigned};
use super::super::sfm::SfmOptions;

/// Defaults for the built-in scene: about two minutes of training.
const BUILTIN_DEFAULTS: [&str; 4] =
    ["train.steps=2000", "train.evaluate_every=500", "train.checkpoint_every=500", "refine.surfel_pixels=1px/MP"];

/// Options that select and change the configuration. Those that set a key take their help from its declaration.
#[derive(Debug, Args)]
pub struct ConfigArgs {
    #[arg(long, value_name = "N", help = key("train.steps").help())]
    pub steps: Option<usize>,
    /// Make the run F times as long; the schedules of its stages and the steps in `[refine]` scale with it
    #[arg(long, value_name = "F", value_parser = factor, allow_negative_numbers = true, conflicts_with = "steps")]
    steps_scale: Option<f64>,
    #[arg(long, value_name = "S", help = key("train.seed").help())]
    seed: Option<u64>,
    /// Configuration that comes with the program, such as cpu; `dpges config --markdown` lists them
    #[arg(long, value_name = "NAME")]
    preset: Option<String>,
    /// Configuration file (TOML); `dpges config` prints one with every key
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Set any key of the configuration, such as refine.budget=50000; may be repeated
    #[arg(long, value_name = "KEY=VALUE")]
    set: Vec<String>,
    #[arg(long, value_name = "NAME", help = key("train.method").help())]
    method: Option<String>,
    #[arg(long, value_name = "FILE", help = key("stages.surfels_from").help())]
    init_surfels: Option<PathBuf>,
    #[arg(long, value_name = "FILE", help = key("stages.gaussians_from").help())]
    init_gaussians: Option<PathBuf>,
    #[arg(long, value_name = "FILE", help = key("data.points").help())]
    points: Option<PathBuf>,
    #[arg(long, value_name = "WHEN", help = key("train.stop").help())]
    stop: Option<String>,
    #[arg(long, value_name = "N|MB|auto", help = key("refine.budget").help())]
    pub budget: Option<String>,
    #[command(flatten)]
    data: DataArgs,
    #[command(flatten)]
    sfm: SfmOptions,
}

impl ConfigArgs {
    /// Whether a preset or a file is named.
    pub fn names_a_whole(&self) -> bool {
        self.preset.is_some() || self.config.is_some()
    }

    /// Whether `--method` is given.
    pub fn names_method(&self) -> bool {
        self.method.is_some()
    }

    /// Whether `--steps` or `--steps-scale` is given.
    pub fn names_length(&self) -> bool {
        self.steps.is_some() || self.steps_scale.is_some()
    }

    /// How cameras are found where photographs of a run of `config` have none.
    pub fn sfm(&self, config: &Config) -> Options {
        self.sfm.options(config.data.invert_masks)
    }

    /// The configuration for a dataset, with `more` (`key=value`) on top.
    pub fn resolve(&self, source: &Source, more: &[String]) -> Result<Config> {
        let mut config = self.resolved(of_dataset(source), self.config.as_deref(), more)?;
        if let Some(factor) = self.steps_scale {
            config.scale_steps(factor)?;
        }
        Ok(config)
    }

    /// `file`, the configuration of a run, with the options on top. Its steps are already scaled.
    pub fn resolve_on(&self, file: &Path) -> Result<Config> {
        self.resolved(&[], Some(file), &[])
    }

    fn resolved(&self, of_dataset: &[&str], file: Option<&Path>, more: &[String]) -> Result<Config> {
        let mut set = self.set.clone();
        set.extend(self.data.assignments());
        set.extend(assigned([
            ("train.steps", self.steps.map(|steps| steps.to_string())),
            ("train.seed", self.seed.map(|seed| seed.to_string())),
            ("refine.budget", self.budget.clone()),
            ("train.method", self.method.clone()),
            ("train.stop", self.stop.clone()),
            ("data.points", self.points.as_deref().map(absolute)),
            ("stages.surfels_from", self.init_surfels.as_deref().map(absolute)),
            ("stages.gaussians_from", self.init_gaussians.as_deref().map(absolute)),
        ]));
        set.extend(more.iter().cloned());
        Ok(Config::resolve_for(of_dataset, self.preset.as_deref(), file, &set)?)
    }
}

/// Defaults for the kind of dataset, as `key=value`.
pub fn of_dataset(source: &Source) -> &'static [&'static str] {
    match source {
        Source::Builtin | Source::Altered(_) => &BUILTIN_DEFAULTS,
        Source::Folder(_) => &[],
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn presets_of_papers_do_not_depend_on_the_dataset() {
        for preset in ["mipnerf360", "tanks-and-temples", "deep-blending", "nerf-synthetic", "ges", "default"] {
            let alone = Config::resolve(Some(preset), None, &[]).unwrap();
            assert_eq!(Config::resolve_for(&BUILTIN_DEFAULTS, Some(preset), None, &[]).unwrap(), alone, "{preset}");
        }
    }
}
