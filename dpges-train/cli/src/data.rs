//! Options that say which dataset is read, how, and which of its views are used.

use std::path::{Path, PathBuf};

use clap::Args;
use dpges_train::config::{Background, Upwards, key};
use dpges_train::dataset::MaxResolution;
pub use dpges_train::dataset::Split;
pub use dpges_train::dataset::source::Source;
use dpges_train::eval::export::format::check_scene_file;
use dpges_train::run::folder::hold_file;
use dpges_train::run::hold::Hold;
pub use dpges_train::run::scene::{Reading, Scene, every_nth, in_scene};
use dpges_train::run::view_choice::ViewChoice;

use super::{Failure, Result, hold_report};

/// Options that replace keys of `[data]`.
#[derive(Debug, Args)]
pub struct DataArgs {
    #[arg(long, value_name = "COLOUR", help = key("data.background").help())]
    pub background: Option<Background>,
    #[arg(long, value_name = "AXIS", allow_hyphen_values = true, help = key("data.up").help())]
    pub up: Option<Upwards>,
    #[arg(long, value_name = "N", help = key("data.image_scale").help())]
    pub image_scale: Option<u32>,
    #[arg(long, value_name = "PX", value_parser = |text: &str| text.parse().map(MaxResolution), help = key("data.max_resolution").help())]
    pub max_resolution: Option<MaxResolution>,
    #[arg(long, value_name = "N", help = key("data.test_every").help())]
    pub test_every: Option<usize>,
    #[arg(long, help = key("data.invert_masks").help())]
    pub invert_masks: bool,
}

/// The options that are given, as `key=value`.
pub fn assigned<const N: usize>(options: [(&str, Option<String>); N]) -> Vec<String> {
    options.into_iter().filter_map(|(key, value)| Some(format!("{key}={}", value?))).collect()
}

/// A path that means the same wherever a run goes on; an empty one stays empty.
pub fn absolute(path: &Path) -> String {
    std::path::absolute(path).unwrap_or_else(|_| path.to_owned()).display().to_string()
}

impl DataArgs {
    /// As `key=value`.
    pub fn assignments(&self) -> Vec<String> {
        assigned([
            ("data.background", self.background.map(|background| background.to_string())),
            ("data.up", self.up.map(|up| up.to_string())),
            ("data.image_scale", self.image_scale.map(|scale| scale.to_string())),
            ("data.max_resolution", self.max_resolution.map(|most| most.0.to_string())),
            ("data.test_every", self.test_every.map(|every| every.to_string())),
            ("data.invert_masks", self.invert_masks.then(|| "true".to_owned())),
        ])
    }

    pub fn reading(&self) -> Reading {
        Reading { background: self.background, up: self.up, assignments: self.assignments() }
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
    pub fn choice(&self) -> ViewChoice {
        ViewChoice { data: self.data.clone(), split: self.split, reading: self.options.reading() }
    }
}

/// The scene of a command that writes another, `out`, and a `report`: both are held before the work begins.
pub fn open_to_write(path: &Path, out: Option<&Path>, report: Option<&Path>) -> Result<(Scene, [Option<Hold>; 2])> {
    out.map(check_scene_file).transpose().map_err(Failure::Usage)?;
    let held = [out.map(hold_file).transpose()?.flatten(), hold_report(report)?];
    let scene = Scene::load(path)?;
    out.map(|out| scene.check_is_not(out)).transpose().map_err(Failure::Usage)?;
    Ok((scene, held))
}
