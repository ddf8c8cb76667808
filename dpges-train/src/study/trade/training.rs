//! What can be turned when a scene is trained: each value is a run, with several seeds.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use burn::tensor::Device;
use dpges_core::scene::ColourModel;
use dpges_train::config::{Config, HARD_RIM, Method};
use dpges_train::dataset::Dataset;
use dpges_train::device::DeviceName;
use dpges_train::eval::simplify::detail_of;
use dpges_train::run::{Observer, budget};

use super::super::series::Common;
use super::super::series::entry::Entry;
use super::limit::Limit;
use super::point::Kind;
use super::sweep::Sweep;
use crate::cli::data::Source;
use crate::cli::logging::LogStyle;
use crate::cli::{Failure, Result};

/// Folder of the runs in that of the measurements.
const FOLDER: &str = "runs";

/// One knob of training at one value.
#[derive(Clone, Debug, PartialEq)]
struct Variation {
    /// Also the name of its folder.
    label: &'static str,
    knob: Option<&'static str>,
    /// `key=value`
    settings: Vec<String>,
}

/// What the runs begin with.
pub struct Training<'a> {
    pub source: &'a Source,
    /// Of the run that the scene comes from, or that `dpges train` would have, with options on top.
    pub config: &'a Config,
    /// The same with more `key=value`.
    pub resolve: &'a dyn Fn(&[String]) -> Result<Config>,
    /// Whether a knob is turned.
    pub is_wanted: &'a dyn Fn(&str) -> bool,
    pub seeds: u64,
    pub name: DeviceName,
    pub device: &'a Device,
    pub style: LogStyle,
    pub interrupted: Arc<AtomicBool>,
}

impl Training<'_> {
    /// Trains and measures what is not measured yet, all variations with the first seed, then with the second, until the
    /// time is over. Folders that hold anything else are refused before the first step.
    pub fn run(&self, sweep: &mut Sweep, out: &Path, limit: &Limit) -> Result<()> {
        let dataset = Arc::new(self.source.load_for_training(self.config)?);
        if dataset.test.is_empty() {
            let message = format!("{} has no held-out views to compare runs on", self.source);
            return Err(Failure::with_help(message, "hold out views with --test-every"));
        }
        let mut variations = variations(self.config, &dataset);
        variations.retain(|variation| variation.knob.is_none_or(self.is_wanted));
        let mut entries = Vec::new();
        for seed in (self.config.train.seed..).take(self.seeds as usize) {
            let seeded = format!("train.seed={seed}");
            for Variation { label, knob, settings } in &variations {
                let config = (self.resolve)(&[&settings[..], std::slice::from_ref(&seeded)].concat())?;
                entries.push((seed, *knob, Entry::new(label, config, &out.join(FOLDER), self.source, self.seeds > 1)?));
            }
        }
        let mut common = self.common(dataset);
        let mut data = self.config.data.clone();
        for (seed, knob, entry) in entries {
            if sweep.store.has(entry.label, Some(seed)) {
                continue;
            }
            if limit.is_over() {
                sweep.leave_out(entry.label, Some(seed));
                continue;
            }
            if entry.config.data != data {
                common = self.common(Arc::new(self.source.load_for_training(&entry.config)?));
                data = entry.config.data.clone();
            }
            match entry.train_watched(&common, &mut Until(limit)) {
                Err(_) if limit.has_stopped() => {
                    tracing::info!("{}: the time is over, the same command goes on with it", entry.label);
                    sweep.leave_out(entry.label, Some(seed));
                    continue;
                }
                other => other?,
            }
            let measured = entry.measured()?;
            let mut point = sweep.point(&entry.scene()?, &[], entry.label, Some(seed))?;
            point.kind = Kind::Training;
            point.knobs = knob.iter().map(|&knob| knob.to_owned()).collect();
            (point.training_seconds, point.training_peak_bytes) = (Some(measured.seconds), measured.peak_memory_bytes);
            sweep.store.add(point)?;
        }
        Ok(())
    }

    fn common(&self, dataset: Arc<Dataset>) -> Common {
        let (source, device, interrupted) = (self.source.clone(), self.device.clone(), Arc::clone(&self.interrupted));
        Common { source, dataset, name: self.name, device, style: self.style, interrupted }
    }
}

/// Ends a run when the time is over.
struct Until<'a>(&'a Limit);

impl Observer for Until<'_> {
    fn should_stop(&mut self) -> bool {
        self.0.stop_if_over()
    }
}

/// The configuration itself, then every value of every knob that changes it.
fn variations(config: &Config, dataset: &Dataset) -> Vec<Variation> {
    let mut all = vec![Variation { label: "trained-again", knob: None, settings: Vec::new() }];
    let mut add = |label, knob, settings: &[(&str, String)]| {
        let settings = settings.iter().map(|(key, value)| format!("{key}={value}")).collect();
        all.push(Variation { label, knob: Some(knob), settings });
    };
    let primitives = budget(config, dataset);
    for (label, parts) in [("budget-half", 2), ("budget-quarter", 4)] {
        add(label, "budget", &[("refine.budget", (primitives / parts).max(1).to_string())]);
    }
    let model = config.model.colour;
    for (label, detail) in [("detail-1", 1), ("detail-0", 0)] {
        let less = match model {
            ColourModel::SphericalBeta { .. } => ColourModel::SphericalBeta { lobes: detail },
            ColourModel::SphericalHarmonics { .. } | ColourModel::HarmonicsAndOpacity { .. } => {
                ColourModel::SphericalHarmonics { degree: detail }
            }
        };
        if detail < detail_of(model) {
            add(label, "detail", &[("model.colour", less.to_string())]);
        }
    }
    let other = match model {
        ColourModel::SphericalBeta { .. } => ("colour-sh3", "sh3"),
        ColourModel::SphericalHarmonics { .. } | ColourModel::HarmonicsAndOpacity { .. } => ("colour-sb2", "sb2"),
    };
    // its opacities depend on the direction as its colours do, by harmonics
    if config.train.method != Method::SortFree {
        add(other.0, "colour", &[("model.colour", other.1.to_owned())]);
    }
    if config.train.method == Method::Dpges {
        for (label, layers) in [("layers-1", 1), ("layers-2", 2), ("layers-4", 4)] {
            // rims fade into what a second layer shows: without one they have to be hard
            let modulation = config.model.modulation.max(if layers == 1 { HARD_RIM } else { 0.0 });
            if layers != config.model.layers {
                let settings = [("model.layers", layers.to_string()), ("model.modulation", modulation.to_string())];
                add(label, "layers", &settings);
            }
        }
        add("method-mcmc", "method", &[("train.method", "mcmc".to_owned())]);
    }
    let longest = dataset.train.iter().map(|view| view.camera.width.max(view.camera.height)).max().unwrap_or(0);
    if longest > 1 {
        add("resolution-half", "resolution", &[("data.max_resolution", (longest / 2).to_string())]);
    }
    for (label, parts) in [("steps-half", 2), ("steps-quarter", 4)] {
        add(label, "steps", &[("train.steps", (config.train.steps / parts).max(1).to_string())]);
    }
    add("steps-double", "steps", &[("train.steps", (2 * config.train.steps).to_string())]);
    all
}

/// The configuration that runs begin with: that of the run in `file`, or what `dpges train` takes for `source`, with
/// `set` (`key=value`) on top.
pub fn base_config(source: &Source, file: Option<&Path>, set: &[String]) -> Result<Config> {
    let config = match file {
        Some(file) => Config::resolve(None, Some(file), set),
        None => Config::resolve_for(crate::cli::train::options::of_dataset(source), None, None, set),
    };
    config.map_err(Failure::from_config)
}

#[cfg(test)]
mod tests {
    use std::collections::HashSet;

    use dpges_train::dataset::{BuiltinOptions, builtin};

    use super::super::knob::KNOBS;
    use super::*;

    fn dataset() -> Dataset {
        builtin(&BuiltinOptions {
            width: 20,
            height: 12,
            train_views: 2,
            test_views: 1,
            points: 10,
            ..Default::default()
        })
    }

    #[test]
    fn every_variation_is_another_configuration_but_the_first() {
        for set in [vec![], vec!["model.colour=sh3".to_owned()], vec!["train.method=mcmc".to_owned()]] {
            let resolve = |more: &[String]| Config::resolve(None, None, &[&set[..], more].concat()).unwrap();
            let base = resolve(&[]);
            let all = variations(&base, &dataset());
            assert_eq!(resolve(&all[0].settings), base);
            assert!(all.iter().map(|variation| variation.label).collect::<HashSet<_>>().len() == all.len());
            for variation in &all[1..] {
                assert!(variation.knob.is_some_and(|knob| KNOBS.contains(&knob)), "{variation:?}");
                assert_ne!(resolve(&variation.settings), base, "{variation:?}");
            }
        }
    }

    #[test]
    fn values_are_parts_of_the_configured_ones() {
        let set = ["refine.budget=1000", "train.steps=8", "model.layers=2"].map(str::to_owned);
        let config = Config::resolve(None, None, &set).unwrap();
        let all = variations(&config, &dataset());
        let settings = |label: &str| all.iter().find(|v| v.label == label).map(|v| v.settings[0].as_str());
        for (label, expected) in [
            ("budget-quarter", "refine.budget=250"),
            ("detail-0", "model.colour=sb0"),
            ("resolution-half", "data.max_resolution=10"),
            ("steps-half", "train.steps=4"),
            ("steps-double", "train.steps=16"),
            ("layers-1", "model.layers=1"),
            ("method-mcmc", "train.method=mcmc"),
        ] {
            assert_eq!(settings(label), Some(expected));
        }
        assert_eq!(settings("layers-2"), None);
        let hard = all.iter().find(|v| v.label == "layers-1").map(|v| v.settings[1].as_str());
        assert_eq!(hard, Some("model.modulation=255"));
    }
}
