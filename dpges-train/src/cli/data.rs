//! Options that say which dataset is read, how, and which of its views are used.

use std::fmt;
use std::path::PathBuf;

use clap::{Args, ValueEnum};
use dpges_train::config::{Background, key};
use dpges_train::dataset::{Dataset, View};
use dpges_train::run::scene::Reading;

use super::{Failure, Result};
pub use dpges_train::dataset::source::Source;
pub use dpges_train::run::scene::{Scene, every_nth, in_scene};

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Split {
    /// Views held out from training
    Test,
    /// Views trained on
    Train,
    /// Views that the run kept from training for its decisions
    Validation,
}

impl Split {
    /// Its views of `dataset`.
    pub fn of(self, dataset: &Dataset) -> &[View] {
        match self {
            Self::Test => &dataset.test,
            Self::Train => &dataset.train,
            Self::Validation => &dataset.validation,
        }
    }
}

impl fmt::Display for Split {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Test => "test",
            Self::Train => "train",
            Self::Validation => "validation",
        })
    }
}

/// Options that replace keys of `[data]`.
#[derive(Debug, Args)]
pub struct DataArgs {
    #[arg(long, value_name = "COLOUR", help = key("data.background").help())]
    pub background: Option<Background>,
    #[arg(long, value_name = "N", help = key("data.image_scale").help())]
    pub image_scale: Option<u32>,
    #[arg(long, value_name = "PX", help = key("data.max_resolution").help())]
    pub max_resolution: Option<usize>,
    #[arg(long, value_name = "N", help = key("data.test_every").help())]
    pub test_every: Option<usize>,
    #[arg(long, help = key("data.invert_masks").help())]
    pub invert_masks: bool,
}

/// The options that are given, as `key=value`.
pub fn assigned<const N: usize>(options: [(&str, Option<String>); N]) -> Vec<String> {
    let given = options.into_iter().filter_map(|(key, value)| Some(format!("{key}={}", value?)));
    given.collect()
}

impl DataArgs {
    /// As `key=value`.
    pub fn assignments(&self) -> Vec<String> {
        assigned([
            ("data.background", self.background.map(|background| background.to_string())),
            ("data.image_scale", self.image_scale.map(|scale| scale.to_string())),
            ("data.max_resolution", self.max_resolution.map(|px| px.to_string())),
            ("data.test_every", self.test_every.map(|every| every.to_string())),
            ("data.invert_masks", self.invert_masks.then(|| "true".to_owned())),
        ])
    }

    pub fn reading(&self) -> Reading {
        Reading { background: self.background, assignments: self.assignments() }
    }
}

/// The views of a dataset from which a scene is shown.
#[derive(Debug, Args)]
pub struct ViewArgs {
    /// Folder of the dataset, or `builtin`; a run knows its own
    #[arg(long, value_name = "DATASET")]
    data: Option<PathBuf>,
    /// Which views [default: test]
    #[arg(long, value_enum)]
    split: Option<Split>,
    #[command(flatten)]
    options: DataArgs,
}

impl ViewArgs {
    /// Those that are asked for, or the held-out ones.
    pub fn split(&self) -> Split {
        self.split.unwrap_or(Split::Test)
    }

    /// The views of the split, as [`dataset`](Self::dataset) has them, and what they were read from.
    pub fn load(&self, scene: &mut Scene) -> Result<(Source, Vec<View>)> {
        let (source, dataset) = self.load_dataset(scene)?;
        Ok((source, self.chosen(&dataset).to_vec()))
    }

    /// Like [`load_dataset`](Self::load_dataset), for a decision: with the split that is asked for, or else that of the views
    /// which the run of the scene kept for decisions, or else of the training views. Held-out views would no longer be held
    /// out.
    pub fn load_to_decide(&self, scene: &mut Scene) -> Result<(Source, Dataset, Split)> {
        if let Some(split) = self.split {
            let (source, dataset) = self.load_dataset(scene)?;
            return Ok((source, dataset, split));
        }
        let (source, dataset) = self.read(scene, true)?;
        let split = if dataset.validation.is_empty() { Split::Train } else { Split::Validation };
        Ok((source, dataset, split))
    }

    /// Like [`dataset`](Self::dataset), but refuses one without views in the split.
    pub fn load_dataset(&self, scene: &mut Scene) -> Result<(Source, Dataset)> {
        let (source, dataset) = self.dataset(scene)?;
        if self.chosen(&dataset).is_empty() {
            let other = match self.split() {
                Split::Test | Split::Validation => Split::Train,
                Split::Train => Split::Test,
            };
            let help = format!("`--split {other}` has views");
            return Err(Failure::with_help(format!("{source} has no views in split `{}`", self.split()), help));
        }
        Ok((source, dataset))
    }

    /// The dataset, with cameras and points in the scene's coordinates, and what it was read from: see [`Scene::dataset`].
    pub fn dataset(&self, scene: &mut Scene) -> Result<(Source, Dataset)> {
        self.read(scene, self.split() == Split::Validation)
    }

    /// The same; validation views are among the training views unless `apart`.
    fn read(&self, scene: &mut Scene, apart: bool) -> Result<(Source, Dataset)> {
        Ok(scene.read(self.data.as_deref(), &self.options.reading(), apart)?)
    }

    /// Those of the views of `dataset` that are asked for.
    pub fn chosen<'a>(&self, dataset: &'a Dataset) -> &'a [View] {
        self.split().of(dataset)
    }

    /// The options that replace keys of `[data]`, as `key=value`.
    pub fn assignments(&self) -> Vec<String> {
        self.options.assignments()
    }

    /// Whether the command line names a dataset.
    pub fn names_dataset(&self) -> bool {
        self.data.is_some()
    }
}

#[cfg(test)]
mod tests {
    use clap::Parser;
    use dpges_core::scene::{ColourModel, GaussianData, SceneData, SceneInfo, SurfelData};
    use dpges_train::config::Config;
    use dpges_train::dataset::source::BUILTIN;
    use dpges_train::run::folder::{Origin, RunFolder};

    use super::*;

    #[derive(Debug, Parser)]
    struct Command {
        #[command(flatten)]
        views: ViewArgs,
    }

    #[test]
    fn held_out_views_decide_only_where_they_are_asked_to() {
        let (folder, model) = (tempfile::tempdir().unwrap(), ColourModel::SphericalBeta { lobes: 0 });
        let scene = SceneData {
            info: SceneInfo { colour_model: model, ..SceneInfo::default() },
            surfels: SurfelData::neutral(model, 0),
            gaussians: GaussianData::neutral(model, 1),
            environment: None,
        };
        let decide = |set: &[&str], arguments: &[&str]| {
            let set: Vec<String> = ["data.max_resolution=4"].iter().chain(set).map(|&text| text.to_owned()).collect();
            let config = Config::resolve(None, None, &set).unwrap();
            let run = RunFolder::new(folder.path());
            run.start(&Origin::new(BUILTIN, "cpu"), &config).unwrap();
            scene.save(&run.scene()).unwrap();
            let views = Command::try_parse_from([&["command"], arguments].concat()).unwrap().views;
            let (_, dataset, split) = views.load_to_decide(&mut Scene::load(folder.path()).unwrap()).unwrap();
            let names: Vec<String> = split.of(&dataset).iter().map(|view| view.name.clone()).collect();
            (split, names)
        };
        let (split, trained) = decide(&[], &[]);
        assert!(split == Split::Train && trained.iter().all(|name| name.starts_with("train_")), "{split} {trained:?}");
        let (split, kept) = decide(&["data.validation_every=4"], &[]);
        assert!(split == Split::Validation && kept.len() == trained.len() / 4, "{split} {kept:?}");
        assert!(kept.iter().all(|name| trained.contains(name)));
        assert_eq!(decide(&["data.validation_every=4"], &["--split=validation"]).1, kept);
        // of another dataset nothing was kept
        assert_eq!(decide(&["data.validation_every=4"], &["--data=builtin"]).0, Split::Train);
        let (split, held_out) = decide(&[], &["--split=test"]);
        assert!(split == Split::Test && held_out.iter().all(|name| name.starts_with("test_")), "{split} {held_out:?}");
    }
}
