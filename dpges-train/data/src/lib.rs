//! Photographs, cameras and points from disk: COLMAP, Blender and nerfstudio folders, cameras of Metashape, RealityScan, OpenSfM and
//! Bundler, and a small built-in scene.
//!
//! `layout` finds the cameras among the files of a folder. A format reader (`colmap`, `nerfstudio`, `guest`) describes the dataset as a
//! list of frames with lenses and poses; `panoramas` puts the faces of a cube in the place of each panorama;
//! `assemble` finds its size and place, and moves geo-referenced worlds to the origin;
//! `inventory` says of the other files that they are not used, by the `conventions` of the programs that write them; and
//! `reading` reads the images in parallel, or only their headers, and then the others when they are needed: `decoder` undistorts
//! them if asked to, and makes them smaller.
//! Cameras have OpenCV axes (x right, y down, z forward).
//!
//! # Dependencies
//!
//! | crate | for |
//! |---|---|
//! | dpges-core, without Burn | cameras, errors, files that are written whole |
//! | glam, nalgebra | poses in f64; eigenvectors, lenses that are fitted |
//! | image, serde-ply, roxmltree | photographs; points in PLY files; cameras in XML |
//! | las with laz, e57 | clouds of surveys and scanners |
//! | kamadak-exif | which camera and lens took a photograph, and how it is turned |
//! | icu_normalizer | names with accents that systems write differently |
//! | kiddo, rayon | nearest neighbours; reading pictures in parallel |
//! | moka | pictures in memory, up to a number of bytes |
//! | rand, rand_chacha | the built-in scene |
//! | plotters, epaint_default_fonts | names on contact sheets, their letters |
//! | clap | values that the command line names |
//! | serde, serde_json, tempfile, thiserror, tracing | cameras in JSON, files, errors, messages |

mod assemble;
pub mod block;
mod builtin;
pub mod camera_file;
pub mod capture;
pub mod check;
mod companions;
mod conventions;
mod empty_space;
mod error;
mod finding;
#[cfg(test)]
mod fixtures;
mod folder;
mod foreign;
mod formats;
mod halved;
mod image;
mod inventory;
mod key;
mod layout;
mod load_options;
pub mod names;
mod near_plane;
pub mod neighbours;
mod panoramas;
mod reprojection;
pub mod source;
mod split;
mod tracks;
mod upwards;
mod world;

use std::fmt;
use std::path::Path;
use std::sync::Arc;

use dpges_core::camera::Camera;
use glam::DVec3;

pub use self::image::cache::least_recently_used;
use self::image::codec::header as image_header;
pub use self::image::depth::{DepthKind, DepthMap};
pub use self::image::masks::Masked;
use self::image::masks::read as read_mask;
pub use self::image::panorama::{Face, stitched, stitched_depth};
pub use self::image::photograph::{MOST_PREFETCHED, Photograph, pictures, prefetch};
pub use self::image::picture::Picture;
pub use builtin::{BuiltinOptions, builtin, builtin_geometry, builtin_panorama, photograph as builtin_photograph};
pub use empty_space::EmptySpace;
pub use error::DatasetError;
pub use finding::{Finding, Kind, Notices};
use formats::colmap::{ModelContent, model_content};
pub use load_options::{LoadOptions, MaxResolution};
pub use split::Split;
pub use tracks::Tracks;
pub use upwards::upwards;

use self::folder::Folder;
use self::formats::source::Source;
use self::image::undistort;
use self::layout::{Cameras, Layout};
use error::Result;

/// Photographs that are looked at before the first step, at most, to decide what does not need all of them.
pub const SAMPLED_VIEWS: usize = 64;

/// The indices of up to [`SAMPLED_VIEWS`] of `count` views, evenly spread, ascending.
pub fn sampled(count: usize) -> impl Iterator<Item = usize> {
    let most = count.min(SAMPLED_VIEWS);
    (0..most).map(move |index| index * count / most)
}

/// A photograph and the camera that took it. Both have the same resolution.
#[derive(Clone, Debug)]
pub struct View {
    /// The image's path within its dataset, unique.
    pub name: String,
    /// In the shifted world, see [`Dataset::offset`].
    pub camera: Camera,
    pub photograph: Photograph,
    /// `None` if there is none, or none was asked for. Only training views have one.
    pub depth: Option<DepthMap>,
    /// The part of the photograph that it is, if that is a panorama.
    pub face: Option<Face>,
}

/// Points on the surfaces of the scene.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PointCloud {
    /// World units, in the shifted world, see [`Dataset::offset`].
    pub positions: Vec<[f32; 3]>,
    /// Red, green, blue in 0..1, display-referred.
    pub colours: Vec<[f32; 3]>,
    /// Indices into [`Dataset::train`] of the views that saw a point; those of no point if nothing is known.
    pub seen_by: Tracks,
}

impl PointCloud {
    /// Adds the points of `other`, whose views are those of this cloud.
    pub fn append(&mut self, other: &Self) {
        while self.seen_by.len() < self.positions.len() {
            self.seen_by.push([]);
        }
        self.positions.extend(&other.positions);
        self.colours.extend(&other.colours);
        other.seen_by.iter().for_each(|views| self.seen_by.push(views.iter().copied()));
    }
}

/// Photographs, cameras and points to train on. Views are sorted by name.
#[derive(Clone, Debug)]
pub struct Dataset {
    pub train: Vec<View>,
    /// Held out from training.
    pub test: Vec<View>,
    /// Excluded from training, for decisions during training, see [`Dataset::keep_for_validation`].
    pub validation: Vec<View>,
    /// Points on surfaces: those of [`LoadOptions::points`], or else of the dataset. Empty if there are none.
    pub points: PointCloud,
    /// Position of this dataset's origin in the coordinates of the files: files = here + offset. World units. It is
    /// zero unless the mean of the camera centres is more than 100 extents from the origin of the files, where the
    /// spacing of f32 would exceed 10⁻⁵ of the extent.
    pub offset: DVec3,
    /// 1.1 × the largest distance of a training camera centre from their mean, world units, without the few that are ten times as
    /// far away as any other; 1 where that is 0.
    pub extent: f64,
    /// Background colour: red, green, blue in 0..1. Images with alpha are composited on it.
    pub background: [f64; 3],
    pub format: Format,
    /// Near plane of every camera, world units.
    pub near: f64,
    /// How far points are from where photographs show them, px of the photographs as they are here: the median over training
    /// views; `None` if the dataset does not say where they are shown.
    pub reprojection_px: Option<f64>,
    /// What it lacks, and what of its files is not used.
    pub notices: Notices,
    /// Memory of [`LoadOptions::memory`] that photographs do not use, bytes: room for other numbers per pixel.
    pub spare_memory: usize,
}

impl View {
    /// The photograph, from memory or from its file.
    ///
    /// # Errors
    /// [`dpges_core::Error::Io`] if the file is not what it was when the dataset was loaded.
    pub fn picture(&self) -> dpges_core::Result<Arc<Picture>> {
        self.photograph.picture()
    }

    /// Changes the photograph, which is in memory from then on.
    ///
    /// # Errors
    /// The errors of [`picture`](Self::picture).
    pub fn repaint(&mut self, change: impl FnOnce(&mut Picture)) -> dpges_core::Result<()> {
        let mut picture = Arc::unwrap_or_clone(self.picture()?);
        change(&mut picture);
        self.photograph = picture.into();
        Ok(())
    }

    /// The image's path within its dataset, also of a part of it.
    pub fn photograph_name(&self) -> String {
        self.face.map_or_else(|| self.name.clone(), |face| face.photograph_of(&self.name))
    }

    /// The camera without its lens: the widest pinhole camera all of whose pixels are on the photograph; `None` if no camera
    /// of half to twice its focal length has that.
    pub fn undistorted_camera(&self) -> Option<Camera> {
        undistort::pinhole(&self.camera)
    }

    /// The view with its [`undistorted_camera`](Self::undistorted_camera), if there is one: the photograph, which is in
    /// memory from then on, and the depth map are resampled for it.
    ///
    /// # Errors
    /// The errors of [`picture`](Self::picture).
    pub fn undistorted(&self) -> dpges_core::Result<Option<Self>> {
        if self.camera.lens.is_none() {
            return Ok(Some(self.clone()));
        }
        let Some(camera) = self.undistorted_camera() else { return Ok(None) };
        let photograph = self.picture()?;
        let picture = undistort::resample(&photograph, &self.camera, &camera);
        let depth = self.depth.as_ref().map(|map| map.seen_by(&camera, &self.camera, &picture));
        Ok(Some(Self { camera, photograph: picture.into(), depth, ..self.clone() }))
    }
}

impl Dataset {
    /// How much of its views is masked.
    pub fn masked(&self) -> Masked {
        Masked::of(self.views())
    }

    /// Training, then held-out, then validation views.
    fn views(&self) -> impl Iterator<Item = &View> {
        self.train.iter().chain(&self.test).chain(&self.validation)
    }

    /// Moves every `every`-th training photograph to [`validation`](Self::validation), the faces of a panorama together; 0 moves
    /// none. It takes the middle one of each group of `every`, because the first is often the end of a path and shows what no
    /// other does. At least two training photographs remain. Points that only removed views saw remain, with no view that sees
    /// them.
    pub fn keep_for_validation(&mut self, every: usize) {
        let is_next = |pair: &[View]| pair[1].face.is_none() || pair[0].photograph_name() != pair[1].photograph_name();
        let mut numbers = vec![0; self.train.len()];
        for (at, pair) in self.train.windows(2).enumerate() {
            numbers[at + 1] = numbers[at] + usize::from(is_next(pair));
        }
        let count = numbers.last().map_or(0, |last| last + 1);
        let first = (every / 2).min(count.saturating_sub(1) / 2);
        let trains: Vec<bool> =
            numbers.iter().map(|number| every <= 1 || count <= 2 || number % every != first).collect();
        self.points.seen_by.keep_views(trains.iter().copied());
        for (trains, view) in trains.into_iter().zip(std::mem::take(&mut self.train)) {
            let views = if trains { &mut self.train } else { &mut self.validation };
            views.push(view);
        }
    }
}

/// The layout that a dataset was read from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    Colmap,
    Blender,
    Nerfstudio,
    Metashape,
    RealityScan,
    OpenSfm,
    Bundler,
    Builtin,
}

impl Format {
    /// Whether photographs beside such cameras are also those of a reconstruction that is to be made anew.
    fn is_guest(self) -> bool {
        matches!(self, Self::Metashape | Self::RealityScan | Self::OpenSfm | Self::Bundler)
    }
}

impl fmt::Display for Format {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Colmap => "COLMAP",
            Self::Blender => "Blender",
            Self::Nerfstudio => "nerfstudio",
            Self::Metashape => "Metashape",
            Self::RealityScan => "RealityScan",
            Self::OpenSfm => "OpenSfM",
            Self::Bundler => "Bundler",
            Self::Builtin => "built-in",
        })
    }
}

/// The layout of the dataset at `path`, its folder or a file of its cameras: COLMAP if it has a folder `sparse`, else Blender if
/// it has `transforms_train.json`, else nerfstudio if it has `transforms.json`, else COLMAP if it has a model elsewhere, else the
/// format of the cameras of another program.
pub fn format(path: &Path) -> Option<Format> {
    Layout::find(path).map(|layout| layout.format())
}

/// Reads the dataset at `path`, see [`format()`]. For more than [`SAMPLED_VIEWS`] photographs without alpha, masks and
/// depth maps it reads only the headers; their pixels follow when they are needed.
///
/// # Errors
/// [`DatasetError`] names the file at fault and the remedy.
pub fn load(path: &Path, options: &LoadOptions) -> Result<Dataset> {
    let Some(layout) = Layout::find(path) else {
        return Err(foreign(path)
            .unwrap_or_else(|| DatasetError::UnknownFormat { path: path.to_owned(), found: names::listing(path) }));
    };
    assemble::assemble(&layout, described(&layout, options)?, options)
}

fn described(layout: &Layout, options: &LoadOptions) -> Result<Source> {
    let mut source = match &layout.cameras {
        Cameras::Colmap(models) => formats::colmap::read(layout, models, options)?,
        Cameras::Transforms { train, held_out } => {
            formats::nerfstudio::read(layout, train, held_out.as_deref(), options)?
        }
        Cameras::Guest { format, files } => formats::guest::read(layout, *format, files, options)?,
    };
    formats::plausible::check(&mut source)?;
    Ok(source)
}

/// The error of a folder with cameras of programs that are not read; `None` if there are none, or whole datasets within.
fn foreign(path: &Path) -> Option<DatasetError> {
    let folder = Folder::read(path);
    let (program, files) = foreign::cameras(&folder).into_iter().next()?;
    if Layout::are_within(&folder) {
        return None;
    }
    Some(DatasetError::ForeignCameras { path: files[0].clone(), program, folder: path.to_owned() })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn validation_views_leave_training_and_the_points() {
        let options =
            BuiltinOptions { width: 4, height: 4, train_views: 5, test_views: 1, points: 0, ..Default::default() };
        let mut dataset = builtin(&options);
        let validation =
            |dataset: &Dataset| -> Vec<String> { dataset.validation.iter().map(|view| view.name.clone()).collect() };
        dataset.points.seen_by = [vec![0, 1, 4], vec![2, 3], vec![3]].into_iter().collect();
        let untouched = dataset.clone();
        dataset.keep_for_validation(0);
        assert_eq!((dataset.train.len(), dataset.validation.len()), (5, 0));
        dataset.keep_for_validation(2);
        assert_eq!(validation(&dataset), ["train_001", "train_003"]);
        assert_eq!(dataset.points.seen_by, [vec![0, 2], vec![1], vec![]].into_iter().collect());
        let mut rare = untouched.clone();
        rare.keep_for_validation(100);
        assert_eq!(validation(&rare), ["train_002"]);
        let mut few = untouched;
        few.train.truncate(2);
        few.points.seen_by = Tracks::default();
        few.keep_for_validation(2);
        assert_eq!((few.train.len(), few.validation.len()), (2, 0));
    }

    #[test]
    fn a_sample_is_all_of_few_views_and_evenly_spread_over_many() {
        for few in [0, 1, SAMPLED_VIEWS] {
            assert_eq!(sampled(few).collect::<Vec<_>>(), (0..few).collect::<Vec<_>>());
        }
        for many in [SAMPLED_VIEWS + 1, 1000] {
            let found: Vec<usize> = sampled(many).collect();
            assert_eq!((found.len(), found[0]), (SAMPLED_VIEWS, 0));
            let steps = found.windows(2).map(|pair| pair[1] - pair[0]);
            assert!(steps.clone().min() >= Some(1) && steps.max().unwrap() <= many.div_ceil(SAMPLED_VIEWS));
            assert!(found[SAMPLED_VIEWS - 1] < many);
        }
    }

    #[test]
    fn unknown_folders_list_what_was_looked_for() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("notes.md"), "").unwrap();
        let (at, options) = (folder.path(), LoadOptions::default());
        let looked_for = ["sparse/", "transforms_train.json", "transforms.json", "Metashape"];
        fixtures::assert_refused(at, &options, &[&looked_for[..], &[at.to_str().unwrap(), "notes.md"]].concat());
        fixtures::assert_refused(&at.join("absent"), &options, &["absent", "no such folder"]);
    }
}
