//! A dataset as a command names it: the built-in scene, or a folder.

use std::fmt;
use std::path::{Path, PathBuf};

use dpges_core::camera::Camera;
use glam::Vec3;

use super::block::Block;
use super::capture::{self, Input, Unusable};
use super::check::{Effort, Report};
use super::formats::cloud;
use super::formats::source::RawPoints;
use super::{BuiltinOptions, Dataset, DatasetError, LoadOptions, PointCloud, builtin, format, load};

/// Why a dataset that a command names cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum SourceError {
    #[error("the built-in scene has pictures of one scale: cap the resolution instead")]
    OneScale,
    /// Of [`BuiltinOptions::altered`].
    #[error("{0}")]
    Change(String),
    #[error("{error}; `dpges sfm {}` finds the cameras of photographs", .path.display())]
    NoCameras { error: DatasetError, path: PathBuf },
    #[error("{error}; its cameras have not been found yet: repeat the command that began it")]
    Unfinished { error: DatasetError },
    #[error(transparent)]
    Unusable(#[from] Unusable),
    #[error(
        "{left} training views of {dataset} are too few to keep every {every}th for decisions; decide by numbers instead: \
         --stop steps, --budget N"
    )]
    TooFewForDecisions { dataset: String, left: usize, every: usize },
    #[error("{} does not fit {dataset}: {reason}; plan the blocks anew (`dpges blocks plan`)", .path.display())]
    Block { path: PathBuf, dataset: String, reason: String },
    #[error(transparent)]
    Dataset(#[from] DatasetError),
    #[error(transparent)]
    Core(#[from] dpges_core::Error),
}

impl SourceError {
    /// Whether it was asked for wrongly, and nothing failed.
    pub fn is_usage(&self) -> bool {
        matches!(self, Self::OneScale | Self::Change(_))
    }
}

type Result<T, E = SourceError> = std::result::Result<T, E>;

impl SourceError {
    /// An error of reading the dataset at `path`, with advice if there are no cameras yet.
    fn explained(error: DatasetError, path: &Path) -> Self {
        if Input::find(path, false).is_some() {
            return Self::NoCameras { error, path: path.to_owned() };
        }
        if capture::is_begun(path) && format(path).is_none() {
            return Self::Unfinished { error };
        }
        match error {
            DatasetError::UnknownFormat { .. } => Self::Unusable(capture::unusable(path)),
            other => other.into(),
        }
    }
}

/// The photographs without cameras or the video that a command names, by absolute paths; `None` for anything else, as for
/// photographs with cameras of another program, unless theirs are to be found `anew`.
pub fn photographs(path: &Path, anew: bool) -> Option<Input> {
    matches!(Source::new(path), Source::Folder(_)).then(|| Input::find(&absolute(path), anew)).flatten()
}

fn absolute(path: &Path) -> PathBuf {
    std::path::absolute(path).unwrap_or_else(|_| path.to_owned())
}

/// The name of a run on the dataset that a command names.
pub fn run_name(dataset: Option<&Path>) -> String {
    let Source::Folder(path) = Source::named(dataset) else { return BUILTIN.to_owned() };
    let path = if path.is_file() { path.parent().unwrap_or(&path) } else { &path };
    let name = dataset.and_then(|dataset| photographs(dataset, false)).and_then(|input| input.name());
    let name = name.or_else(|| Some(path.file_name()?.to_string_lossy().into_owned()));
    name.unwrap_or_else(|| "dataset".to_owned())
}

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
    /// The built-in scene with changes that [`BuiltinOptions::altered`] takes.
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
    /// without cameras it is the folder of the dataset that [`capture::reconstruct`] makes of them.
    pub fn named(dataset: Option<&Path>) -> Self {
        match dataset.map_or(Self::Builtin, Self::new) {
            Self::Folder(path) => {
                let beside = photographs(&path, false).and_then(|input| capture::dataset_beside(&input).ok());
                Self::Folder(beside.unwrap_or_else(|| absolute(&path)))
            }
            builtin => builtin,
        }
    }

    /// Reads it, and logs what it is.
    ///
    /// # Errors
    /// [`SourceError`].
    pub fn load(&self, options: &LoadOptions) -> Result<Dataset> {
        let dataset = match self {
            Self::Builtin => from_builtin("", options)?,
            Self::Altered(changes) => from_builtin(changes, options)?,
            Self::Folder(path) => load(path, options).map_err(|error| SourceError::explained(error, path))?,
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

    /// The dataset of a run, without the views that are kept for its decisions, every
    /// `validation_every`th training view if that is not 0, and those of other blocks than the one in the file `block`; warns of what is wrong with it.
    ///
    /// # Errors
    /// [`SourceError`].
    pub fn load_for_training(
        &self,
        options: &LoadOptions,
        block: Option<&Path>,
        validation_every: usize,
    ) -> Result<Dataset> {
        let mut dataset = self.load(options)?;
        if let Some(path) = block {
            let wrong = |reason| SourceError::Block { path: path.to_owned(), dataset: self.to_string(), reason };
            dataset.keep_block(&Block::read(path)?).map_err(wrong)?;
        }
        if let Self::Folder(_) = self {
            let report = Report::of(&dataset, Effort::Quick)?;
            report.notes.iter().for_each(|note| tracing::info!("{note}"));
            report.findings.iter().for_each(|finding| tracing::warn!("{finding}"));
        }
        dataset.keep_for_validation(validation_every);
        if validation_every > 0 {
            let (kept, left) = (dataset.validation.len(), dataset.train.len());
            if kept == 0 {
                let dataset = self.to_string();
                return Err(SourceError::TooFewForDecisions { dataset, left, every: validation_every });
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

fn from_builtin(changes: &str, options: &LoadOptions) -> Result<Dataset> {
    if options.image_scale.is_some() {
        return Err(SourceError::OneScale);
    }
    let size = options.max_resolution.of(BUILTIN_SIZE);
    let scene = BuiltinOptions {
        width: size,
        height: size,
        points: BUILTIN_POINTS,
        depth: options.depth,
        ..Default::default()
    };
    let scene = scene.altered(changes).map_err(SourceError::Change)?;
    let mut dataset = builtin(&scene);
    if options.undistort && scene.fisheye {
        for view in dataset.train.iter_mut().chain(&mut dataset.test) {
            *view = view.undistorted()?.expect("the middle of a fisheye picture fits a pinhole camera");
        }
    }
    if let Some(colour) = options.background {
        dataset.background = colour;
    }
    dataset.spare_memory = options.memory;
    if let Some(near) = options.near {
        dataset.near = near;
        dataset.train.iter_mut().chain(&mut dataset.test).for_each(|view| view.camera.near = near);
    }
    if let Some(path) = &options.points {
        let cameras: Vec<Camera> = dataset.train.iter().map(|view| view.camera).collect();
        let PointCloud { positions, colours, seen_by } = std::mem::take(&mut dataset.points);
        let positions = positions.into_iter().map(|position| Vec3::from_array(position).as_dvec3()).collect();
        let own = RawPoints { positions, colours, seen_by };
        let measured = cloud::read(path, &cameras, &own, dataset.extent, &mut dataset.notices)?;
        let positions = measured.positions.iter().map(|position| position.as_vec3().to_array()).collect();
        dataset.points = PointCloud { positions, colours: measured.colours, seen_by: measured.seen_by };
    }
    Ok(dataset)
}
