//! Which scene is shown, and the views it is shown from.

use std::fmt;
use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};
use dpges_core::camera::Camera;
use dpges_core::scene::{SceneData, SceneInfo};
use dpges_train::config::{Background, Config, DataConfig, DepthMaps, key};
use dpges_train::dataset::{self, BuiltinOptions, Dataset, View};
use dpges_train::run::folder::RunFolder;
use dpges_train::run::metrics_log::MetricsLog;
use dpges_train::views::pose::{RefinedPoses, refine};
use glam::{DVec3, Vec3};

use super::{Failure, Result, inspect, sfm};

/// Name of the scene that needs no files.
pub const BUILTIN: &str = "builtin";
/// Pictures of the built-in scene are this wide and high, unless the resolution is capped lower, px.
const BUILTIN_SIZE: usize = 160;
/// Points the built-in scene starts from.
const BUILTIN_POINTS: usize = 4000;

/// Where photographs come from.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Source {
    Builtin,
    /// The built-in scene with something wrong: what [`BuiltinOptions::altered`] takes.
    Altered(String),
    Folder(PathBuf),
}

impl Source {
    /// `builtin`, `builtin:CHANGES`, or the path of a folder.
    pub fn new(text: &Path) -> Self {
        match text.to_str().and_then(|text| text.strip_prefix(BUILTIN)).map(|rest| (rest, rest.strip_prefix(':'))) {
            Some(("", _)) => Self::Builtin,
            Some((_, Some(changes))) => Self::Altered(changes.to_owned()),
            _ => Self::Folder(text.to_owned()),
        }
    }

    /// As a command names it: the folder by its absolute path, the built-in scene where there is none. For photographs
    /// without cameras it is the folder of the dataset that [`sfm::prepare`] makes of them.
    pub fn named(dataset: Option<&Path>) -> Self {
        match dataset.map_or(Self::Builtin, Self::new).absolute() {
            Self::Folder(path) => Self::Folder(sfm::dataset_of(&path).unwrap_or(path)),
            builtin => builtin,
        }
    }

    /// With an absolute path where there is a folder.
    fn absolute(self) -> Self {
        match self {
            Self::Folder(path) => Self::Folder(std::path::absolute(&path).unwrap_or(path)),
            builtin => builtin,
        }
    }

    pub fn load(&self, config: &DataConfig) -> Result<Dataset> {
        let dataset = match self {
            Self::Builtin => builtin("", config)?,
            Self::Altered(changes) => builtin(changes, config)?,
            Self::Folder(path) => {
                dataset::load(path, &config.load_options()).map_err(|error| sfm::explained(error, path))?
            }
        };
        let Dataset { train, test, points, format, extent, .. } = &dataset;
        let [width, height] = train.first().map_or([0; 2], |view| [view.camera.width, view.camera.height]);
        tracing::info!(
            "{self}: {format}, {} training and {} held-out views of {width}x{height} px, {} points, extent {extent:.3}",
            train.len(),
            test.len(),
            points.positions.len()
        );
        let masked = dataset.masked();
        if masked.masked_views > 0 {
            tracing::info!("{masked}");
        }
        Ok(dataset)
    }
}

impl Source {
    /// The dataset of a run: without the views that are kept for its decisions.
    pub fn load_for_training(&self, config: &Config) -> Result<Dataset> {
        let mut dataset = self.load(&config.data)?;
        if let Self::Folder(_) = self {
            inspect::warn(&dataset)?;
        }
        let every = config.validation_every();
        dataset.keep_for_validation(every);
        if every > 0 {
            let (kept, left) = (dataset.validation.len(), dataset.train.len());
            if kept == 0 {
                let help = "decide by numbers instead: --stop steps, --budget N";
                let message =
                    format!("{left} training views of {self} are too few to keep every {every}th for decisions");
                return Err(Failure::with_help(message, help));
            }
            tracing::info!("{kept} training views are kept for decisions, {left} are trained on");
        }
        Ok(dataset)
    }
}

impl fmt::Display for Source {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Builtin => f.write_str(BUILTIN),
            Self::Altered(changes) => write!(f, "{BUILTIN}:{changes}"),
            Self::Folder(path) => path.display().fmt(f),
        }
    }
}

fn builtin(changes: &str, config: &DataConfig) -> Result<Dataset> {
    if config.image_scale != 1 {
        return Err(Failure::Usage("the built-in scene has pictures of one scale: cap the resolution instead".into()));
    }
    let cap = if config.max_resolution == 0 { BUILTIN_SIZE } else { config.max_resolution };
    let size = cap.min(BUILTIN_SIZE);
    let options = BuiltinOptions {
        width: size,
        height: size,
        points: BUILTIN_POINTS,
        depth: config.load_options().depth,
        ..Default::default()
    };
    let options = options.altered(changes).map_err(Failure::Usage)?;
    let mut dataset = dataset::builtin(&options);
    if config.undistort && options.fisheye {
        for view in dataset.train.iter_mut().chain(&mut dataset.test) {
            *view = view.undistorted()?.expect("the middle of a fisheye picture fits a pinhole camera");
        }
    }
    if let Background::Colour(colour) = config.background {
        dataset.background = colour;
    }
    dataset.spare_memory = config.memory.bytes();
    if config.near > 0.0 {
        dataset.near = config.near;
        dataset.train.iter_mut().chain(&mut dataset.test).for_each(|view| view.camera.near = config.near);
    }
    Ok(dataset)
}

/// A scene file, and the run it comes from where there is one.
pub struct Scene {
    pub path: PathBuf,
    pub data: SceneData,
    /// Size of the file.
    pub bytes: u64,
    run: Option<RunFolder>,
    /// Whether datasets are read for pinhole cameras alone.
    pinhole: bool,
}

impl Scene {
    /// From a scene file or a run folder; a file in a run folder is the same as the folder.
    pub fn load(path: &Path) -> Result<Self> {
        let folder = RunFolder::new(if path.is_dir() { path } else { path.parent().unwrap_or(path) });
        let is_run = folder.config().is_file() && folder.origin().is_file();
        let path = Self::check(path)?;
        let data = SceneData::load(&path)?;
        let bytes = std::fs::metadata(&path)?.len();
        Ok(Self { path, data, bytes, run: is_run.then_some(folder), pinhole: false })
    }

    /// Reads photographs that were taken through a lens for pinhole cameras, whatever the run was trained with: what
    /// follows draws nothing else.
    pub fn use_pinholes(&mut self) {
        self.pinhole = true;
    }

    /// The scene file that `path` names, which is there.
    pub fn check(path: &Path) -> Result<PathBuf> {
        let path = if path.is_dir() { RunFolder::new(path).scene() } else { path.to_owned() };
        if path.is_file() {
            return Ok(path);
        }
        let help = "name a scene file or the folder of a run (`dpges train --out FOLDER` makes one)";
        Err(Failure::with_help(format!("there is no scene file {}", path.display()), help))
    }

    /// Time that its training took, s; `None` unless the file is the result of a run.
    pub fn training_seconds(&self) -> Result<Option<f64>> {
        let Some(run) = self.run.as_ref().filter(|run| run.scene() == self.path && run.metrics().is_file()) else {
            return Ok(None);
        };
        Ok(Some(MetricsLog::seconds_of_steps(&run.metrics())?))
    }

    /// Whether the run that the scene comes from has corrected exposures.
    pub fn has_exposure(&self) -> bool {
        self.run.as_ref().is_some_and(|run| run.exposure().is_file())
    }

    /// Where the training cameras of the dataset are by the run that the scene comes from: nowhere else than it says if the run
    /// has not refined their poses, or if the dataset is another one, `data`.
    pub fn refined_poses(&self, data: Option<&Path>) -> Result<RefinedPoses> {
        let run = self.run.as_ref().filter(|_| data.is_none());
        Ok(run.map(RunFolder::read_poses).transpose()?.flatten().unwrap_or_default())
    }

    /// The configuration of the run that the scene comes from, where there is one.
    pub fn run_config(&self) -> Option<PathBuf> {
        self.run.as_ref().map(RunFolder::config)
    }

    /// Every how many-th training view of the dataset the run that the scene comes from kept for its decisions: 0 if it kept
    /// none, or if the dataset is another one, `data`.
    fn validation_every(&self, data: Option<&Path>) -> usize {
        let file = self.run_config().filter(|_| data.is_none());
        let config = file.and_then(|file| Config::of_run(&file).ok());
        config.map_or(0, |config| config.validation_every())
    }

    /// The dataset to show the scene with, and how it is read: `data`, or that of the scene's run; `None` if there is
    /// neither. The options of a run are those it was trained with, unless given; the background is the scene's, unless
    /// given, and then the scene's too.
    pub fn dataset(&mut self, data: Option<&Path>, options: &DataArgs) -> Result<Option<(Source, DataConfig)>> {
        let source = match (data, &self.run) {
            (Some(path), _) => Source::new(path),
            (None, Some(run)) => Source::new(Path::new(&run.read_origin()?.dataset)),
            (None, None) => return Ok(None),
        };
        let file = self.run.as_ref().map(RunFolder::config);
        let mut config = Config::resolve_data(file.as_deref(), &options.assignments()).map_err(Failure::from_config)?;
        match options.background {
            Some(Background::Colour(colour)) => self.data.info.background = colour,
            _ => config.background = Background::Colour(self.data.info.background),
        }
        config.undistort |= self.pinhole;
        // only training looks at them
        config.depth = DepthMaps::None;
        Ok(Some((source, config)))
    }
}

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

impl DataArgs {
    /// As `key=value`.
    pub fn assignments(&self) -> Vec<String> {
        let set = |key: &str, value: Option<String>| value.map(|value| format!("data.{key}={value}"));
        let text = |value: Option<usize>| value.map(|value| value.to_string());
        [
            set("background", self.background.map(|background| background.to_string())),
            set("image_scale", self.image_scale.map(|scale| scale.to_string())),
            set("max_resolution", text(self.max_resolution)),
            set("test_every", text(self.test_every)),
            set("invert_masks", self.invert_masks.then(|| "true".to_owned())),
        ]
        .into_iter()
        .flatten()
        .collect()
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
        let Some((source, config)) = scene.dataset(self.data.as_deref(), &self.options)? else {
            let message = format!("{} is not in a run folder: name its dataset with --data", scene.path.display());
            return Err(Failure::Usage(message));
        };
        let mut dataset = source.load(&config)?;
        refine(&mut dataset.train, &scene.refined_poses(self.data.as_deref())?);
        dataset.keep_for_validation(if apart { scene.validation_every(self.data.as_deref()) } else { 0 });
        let offset = dataset.offset;
        for view in dataset.train.iter_mut().chain(&mut dataset.test).chain(&mut dataset.validation) {
            view.camera = in_scene(view.camera, offset, &scene.data.info);
        }
        let shift = (DVec3::from_array(scene.data.info.offset) - offset).as_vec3();
        for point in &mut dataset.points.positions {
            *point = (Vec3::from_array(*point) - shift).to_array();
        }
        Ok((source, dataset))
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

/// A camera of a dataset that was moved by `offset`, in the coordinates of a scene.
pub fn in_scene(camera: Camera, offset: DVec3, info: &SceneInfo) -> Camera {
    let shift = DVec3::from_array(info.offset) - offset;
    Camera { camera_from_world: camera.camera_from_world.recentred(shift), near: info.near, ..camera }
}

/// At most `most` of `views`, evenly chosen; at least one, if there are any.
pub fn every_nth(views: &[View], most: usize) -> impl Iterator<Item = &View> {
    views.iter().step_by(views.len().div_ceil(most.max(1)).max(1))
}

#[cfg(test)]
mod tests {
    use clap::Parser;
    use dpges_core::scene::{ColourModel, GaussianData, SurfelData};
    use dpges_train::run::folder::Origin;

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
