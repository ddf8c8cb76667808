//! A scene with what is known of it: the run it comes from, and the dataset it was trained on.

use std::path::{Path, PathBuf};

use dpges_core::camera::Camera;
use dpges_core::scene::{BlendOrder, SceneData, SceneInfo};
use dpges_render::Up;
use dpges_render::export;
use glam::{DVec3, Vec3};

use super::folder::{RunFolder, RunFolderError};
use super::metrics_log::MetricsLog;
use crate::config::{Background, Config, ConfigError, DataConfig, DepthMaps, Upwards};
use crate::dataset::source::{Source, SourceError};
use crate::dataset::{Dataset, Split, View};
use crate::views::pose::{RefinedPoses, refine};

/// Why a scene, or the dataset to show it with, cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum SceneError {
    #[error(
        "there is no scene file {}; name a scene file or the folder of a run (`dpges train --out FOLDER` makes one)",
        .path.display()
    )]
    Absent { path: PathBuf },
    #[error("{} is not in a run folder: name its dataset with --data", .path.display())]
    NoDataset { path: PathBuf },
    #[error("the dataset of the run is no longer at {}: name where it is now with --data", .dataset.display())]
    Gone { dataset: PathBuf },
    #[error("{dataset} has no views in split `{split}`; `--split {other}` has views")]
    NoViews { dataset: String, split: Split, other: Split },
    #[error(transparent)]
    Config(#[from] ConfigError),
    #[error(transparent)]
    Source(#[from] SourceError),
    #[error(transparent)]
    Folder(#[from] RunFolderError),
    #[error(transparent)]
    Core(#[from] dpges_core::Error),
}

impl SceneError {
    /// Whether it was asked for wrongly, and nothing failed.
    pub fn is_usage(&self) -> bool {
        match self {
            Self::NoDataset { .. } => true,
            Self::Config(error) => error.is_usage(),
            Self::Source(error) => error.is_usage(),
            _ => false,
        }
    }
}

type Result<T, E = SceneError> = std::result::Result<T, E>;

/// How the dataset of a scene is read.
#[derive(Clone, Debug, Default)]
pub struct Reading {
    /// The background in place of that of the scene.
    pub background: Option<Background>,
    /// The upward direction in place of that of the dataset.
    pub up: Option<Upwards>,
    /// Keys of `[data]`, as `key=value`.
    pub assignments: Vec<String>,
}

/// A scene in a file, and the run it comes from where there is one.
pub struct Scene {
    pub path: PathBuf,
    pub data: SceneData,
    pub bytes: u64,
    run: Option<RunFolder>,
    /// Whether the file says all of the scene: a dataset knows more about splats of other programs.
    own: bool,
    /// Whether datasets are read for pinhole cameras alone.
    pinhole: bool,
}

impl Scene {
    /// From a scene file, a file of splats or a run folder; a file in a run folder is the same as the folder.
    ///
    /// # Errors
    /// [`SceneError::Absent`], and those of [`export::open`].
    pub fn load(path: &Path) -> Result<Self> {
        let folder = RunFolder::new(if path.is_dir() { path } else { path.parent().unwrap_or(path) });
        let is_run = folder.config().is_file() && folder.origin().is_file();
        let path = Self::check(path)?;
        let export::Opened { scene, own, remarks } = export::open(&path)?;
        remarks.iter().for_each(|text| tracing::warn!("{}: {text}", path.display()));
        let bytes = path.metadata().map_or(0, |metadata| metadata.len());
        Ok(Self { path, data: scene, bytes, run: is_run.then_some(folder), own, pinhole: false })
    }

    /// Checks that `out` is another file than that of this scene, which would be lost.
    ///
    /// # Errors
    /// A sentence that names the file.
    pub fn check_is_not(&self, out: &Path) -> Result<(), String> {
        let [a, b] = [out, &*self.path].map(|path| path.canonicalize().ok());
        if a.is_some() && a == b {
            return Err(format!("--out is the scene itself, {}: name another file", self.path.display()));
        }
        Ok(())
    }

    /// The coarsest level of a scene in levels of detail: it knows no run.
    pub fn of_levels(path: &Path, coarsest: SceneData) -> Self {
        Self { path: path.to_owned(), data: coarsest, bytes: 0, run: None, own: true, pinhole: false }
    }

    /// Reads photographs that were taken through a lens for pinhole cameras, whatever the run was trained with: what
    /// follows draws nothing else.
    pub fn use_pinholes(&mut self) {
        self.pinhole = true;
    }

    /// The scene file that `path` names, which is there.
    ///
    /// # Errors
    /// [`SceneError::Absent`].
    pub fn check(path: &Path) -> Result<PathBuf> {
        let in_folder = || {
            let (scene, sog) = (RunFolder::new(path).scene(), path.join("meta.json"));
            if !scene.is_file() && sog.is_file() { sog } else { scene }
        };
        let path = if path.is_dir() { in_folder() } else { path.to_owned() };
        if path.is_file() {
            return Ok(path);
        }
        Err(SceneError::Absent { path })
    }

    /// Warns if its Gaussians are sorted for each pixel, or met by rays, where `what` sorts them by their centres.
    pub fn warn_of_order(&self, what: &str) {
        let trained = match self.data.info.blend_order {
            BlendOrder::Centres => return,
            BlendOrder::Rays => "for each pixel along its ray as they were trained (StopThePop)",
            BlendOrder::Whitened(_) => "met by the rays of pixels as they were trained (HTGS)",
        };
        tracing::warn!(
            "{what} the Gaussians by their centres (3DGS), and not {trained}: pictures differ a little, and pop"
        );
    }

    /// Time that its training took, s; `None` unless the file is the result of a run.
    ///
    /// # Errors
    /// If the log of the run cannot be read.
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
    ///
    /// # Errors
    /// If the file of poses is broken.
    pub fn refined_poses(&self, data: Option<&Path>) -> Result<RefinedPoses> {
        let run = self.run.as_ref().filter(|_| self.is_own(data));
        Ok(run.map(RunFolder::read_poses).transpose()?.flatten().unwrap_or_default())
    }

    /// Whether `data` is the dataset that the scene was trained on: none other, or where that is now if its folder is gone.
    fn is_own(&self, data: Option<&Path>) -> bool {
        let trained = self
            .run
            .as_ref()
            .and_then(|run| run.read_origin().ok())
            .map(|origin| Source::new(Path::new(&origin.dataset)));
        match (data, trained) {
            (None, _) => true,
            (Some(data), Some(Source::Folder(folder))) => {
                Source::new(data) == Source::Folder(folder.clone()) || !folder.exists()
            }
            (Some(data), trained) => trained.is_some_and(|trained| trained == Source::new(data)),
        }
    }

    /// The configuration of the run that the scene comes from, where there is one.
    pub fn run_config(&self) -> Option<PathBuf> {
        self.run.as_ref().map(RunFolder::config)
    }

    /// Every how many-th training view of the dataset the run that the scene comes from kept for its decisions: 0 if it kept
    /// none, or if the dataset is another one, `data`.
    fn validation_every(&self, data: Option<&Path>) -> usize {
        let file = self.run_config().filter(|_| self.is_own(data));
        let config = file.and_then(|file| Config::resolve(None, Some(&file), &[]).ok());
        config.map_or(0, |config| config.validation_every())
    }

    /// Sets the background and what is up as `options` ask for.
    ///
    /// # Errors
    /// [`SceneError::Config`] for pictures without a background: nothing else can be.
    pub fn show_as(&mut self, options: &Reading) -> Result<()> {
        match options.background {
            Some(Background::Colour(colour)) => self.data.info.background = colour,
            Some(Background::Transparent) => {
                return Err(Config::with(&["data.background=transparent"]).unwrap_err().into());
            }
            Some(Background::Auto) | None => {}
        }
        if let Some(Upwards::Along(up)) = options.up {
            self.data.info.up = Some(up.direction().to_array());
        }
        Ok(())
    }

    /// The dataset to show the scene with, and how it is read: `data`, or that of the scene's run; `None` if there is
    /// neither. The options of a run are those it was trained with, unless given; the background is the scene's, unless
    /// given, and then the scene's too.
    ///
    /// # Errors
    /// If the run does not say what it was trained on, or an option is wrong.
    pub fn dataset(&mut self, data: Option<&Path>, options: &Reading) -> Result<Option<(Source, DataConfig)>> {
        self.show_as(options)?;
        let source = match (data, &self.run) {
            (Some(path), _) => Source::new(path),
            (None, Some(run)) => match Source::new(Path::new(&run.read_origin()?.dataset)) {
                Source::Folder(dataset) if !dataset.exists() => return Err(SceneError::Gone { dataset }),
                source => source,
            },
            (None, None) => return Ok(None),
        };
        let file = self.run.as_ref().map(RunFolder::config);
        let mut config = Config::resolve_data(file.as_deref(), &options.assignments)?;
        config.background = Background::Colour(self.data.info.background);
        config.undistort |= self.pinhole;
        // only training looks at them
        config.depth = DepthMaps::None;
        config.points.clear();
        Ok(Some((source, config)))
    }

    /// The dataset to show the scene with, as [`dataset`](Self::dataset) says, with cameras and points in the scene's
    /// coordinates, and what it was read from. Validation views are among the training views unless `apart`.
    ///
    /// # Errors
    /// [`SceneError::NoDataset`] if none is known; those of reading it.
    pub fn read(&mut self, data: Option<&Path>, options: &Reading, apart: bool) -> Result<(Source, Dataset)> {
        let Some((source, config)) = self.dataset(data, options)? else {
            return Err(SceneError::NoDataset { path: self.path.clone() });
        };
        let mut dataset = source.load(&config.load_options())?;
        refine(&mut dataset.train, &self.refined_poses(data)?);
        dataset.keep_for_validation(if apart { self.validation_every(data) } else { 0 });
        self.learn_from(&dataset);
        let offset = dataset.offset;
        for view in dataset.train.iter_mut().chain(&mut dataset.test).chain(&mut dataset.validation) {
            view.camera = in_scene(view.camera, offset, &self.data.info);
        }
        let shift = (DVec3::from_array(self.data.info.offset) - offset).as_vec3();
        for point in &mut dataset.points.positions {
            *point = (Vec3::from_array(*point) - shift).to_array();
        }
        Ok((source, dataset))
    }
}

impl Scene {
    /// Takes from `dataset` what the file of the scene does not say.
    fn learn_from(&mut self, dataset: &Dataset) {
        let info = &mut self.data.info;
        if !self.own {
            (info.near, info.extent) = (dataset.near, dataset.extent);
        }
        if info.up.is_none() {
            let up = Up::of_cameras(dataset.train.iter().map(|view| &view.camera));
            info.up = up.map(|up| up.direction().to_array());
        }
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
    use super::*;
    use crate::dataset::builtin;
    use crate::run::fixtures::options;

    #[test]
    fn views_are_spread_over_all() {
        let views = builtin(&options(4, [7, 1], 0)).train;
        let names = |most: usize| every_nth(&views, most).map(|view| view.name.as_str()).collect::<Vec<_>>();
        assert_eq!(names(3), ["train_000", "train_003", "train_006"]);
        assert_eq!((names(100).len(), names(1).len(), names(0).len()), (7, 1, 1));
    }
}
