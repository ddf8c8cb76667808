//! Errors in datasets on disk. Every message names the file, what was found there, and the remedy.

use std::path::{Path, PathBuf};

pub type Result<T, E = DatasetError> = std::result::Result<T, E>;

#[derive(Debug, thiserror::Error)]
pub enum DatasetError {
    #[error(
        "{path} is no dataset this program reads: looked for sparse/ (COLMAP), transforms_train.json (Blender) and \
         transforms.json (nerfstudio), found {found}; point to the folder that holds one of them"
    )]
    UnknownFormat { path: PathBuf, found: String },
    #[error(
        "{path} holds no COLMAP model: looked for cameras.bin or cameras.txt in it and in its subfolders, \
         found {found}; point to the folder above sparse/0"
    )]
    NoModel { path: PathBuf, found: String },
    #[error("{path} is missing, and so is {alternative}; export the model again")]
    MissingModelFile { path: PathBuf, alternative: &'static str },
    #[error("cannot read {path}: {source}")]
    Read { path: PathBuf, source: std::io::Error },
    #[error(
        "{path} is truncated or corrupt: {what} needs at least {needed} bytes, {left} are left; copy or export it again"
    )]
    Truncated { path: PathBuf, what: String, needed: u64, left: usize },
    #[error("{path}: {what} is {found}, expected {expected}; repair the entry or remove it")]
    Malformed { path: PathBuf, what: String, found: String, expected: &'static str },
    #[error("{path} is not the JSON of a transforms file: {source}; NaN and infinity are not JSON either")]
    Json { path: PathBuf, source: serde_json::Error },
    #[error("{path} is not a readable PLY point cloud: {source}; export it again or remove `ply_file_path`")]
    Ply { path: PathBuf, source: serde_ply::DeserializeError },
    #[error(
        "{path}: camera model {model} of {camera} is not supported: {reason}; \
         convert it to another model or undistort the photographs to PINHOLE first"
    )]
    CameraModel { path: PathBuf, camera: String, model: String, reason: &'static str },
    #[error(
        "{path}: the distortion of view `{view}` cannot be undone with a pinhole camera of half to twice its focal \
         length; check its coefficients, undistort the photographs first, or use them as they are (`data.undistort` = false)"
    )]
    Distortion { path: PathBuf, view: String },
    #[error("{path}: view `{view}`: {source}; repair the view or remove it")]
    Camera { path: PathBuf, view: String, source: Box<dpges_core::Error> },
    #[error("{path}: view `{view}` has neither `fl_x` nor `camera_angle_x`; add one for the file or for the frame")]
    NoFocalLength { path: PathBuf, view: String },
    #[error("{path}: no views; a dataset needs at least one photograph with a pose")]
    NoViews { path: PathBuf },
    #[error("{path}: no training views, all {held_out} are held out; hold out fewer (`test_every`)")]
    NoTrainingViews { path: PathBuf, held_out: usize },
    #[error("{path}: no test views: {reason}; set `test_every` = 0 to train without held-out views")]
    NoTestViews { path: PathBuf, reason: &'static str },
    #[error(
        "{path} holds no points, training from a COLMAP model starts from them; run the point triangulator or \
         export the model again"
    )]
    NoPoints { path: PathBuf },
    /// An image, a mask or a depth map; `words` say which, and what to do.
    #[error("{} {path} of view `{view}` is missing; {described_in} names it, restore the file{}", words[0], words[1])]
    Missing { words: &'static [&'static str; 2], path: PathBuf, view: String, described_in: PathBuf },
    /// Likewise.
    #[error(
        "{} {path} is {}x{} px, its camera in {described_in} {}x{}; their aspects differ, use the {}",
        words[0], found[0], found[1], camera[0], camera[1], words[1]
    )]
    Aspect {
        words: &'static [&'static str; 2],
        path: PathBuf,
        found: [usize; 2],
        camera: [usize; 2],
        described_in: PathBuf,
    },
    #[error("{path} has no depth maps; set `data.depth` = \"none\" to train without them")]
    NoDepth { path: PathBuf },
    #[error("depth map {path} is an image of type {found}, expected {expected}; export it again")]
    DepthType { path: PathBuf, found: String, expected: &'static str },
    #[error("folder {path} is missing, there are {available}; use an image scale that exists, or cap the resolution")]
    MissingScale { path: PathBuf, available: String },
    #[error("image {path} cannot be decoded: {source}; replace it, as PNG or JPEG, or remove the view")]
    Decode { path: PathBuf, source: image::ImageError },
    #[error(
        "mask {mask} is {}x{} px, its image {image} {}x{}; make the mask anew for this image, or remove it",
        found[0], found[1], expected[0], expected[1]
    )]
    MaskSize { mask: PathBuf, found: [usize; 2], image: PathBuf, expected: [usize; 2] },
    #[error(
        "no pixel of image {path} of view `{view}` counts: masks are white where a picture counts; turn them round \
         (--invert-masks), or remove the view"
    )]
    NothingCounts { path: PathBuf, view: String },
    #[error(
        "{path}: the lens of view `{view}` shows nothing at any pixel of its photograph; check its coefficients and its \
         principal point, or undistort the photographs first"
    )]
    LensShowsNothing { path: PathBuf, view: String },
}

impl DatasetError {
    pub(super) fn missing_image(path: PathBuf, view: &str, described_in: &Path) -> Self {
        let (view, described_in) = (view.to_owned(), described_in.to_owned());
        Self::Missing { words: &["image", " or remove the view"], path, view, described_in }
    }

    pub(super) fn malformed(path: &Path, what: String, found: impl ToString, expected: &'static str) -> Self {
        Self::Malformed { path: path.to_owned(), what, found: found.to_string(), expected }
    }
}

/// An error of the file system as [`DatasetError::Read`], for `map_err`.
pub(super) fn unreadable(path: &Path) -> impl FnOnce(std::io::Error) -> DatasetError {
    |source| DatasetError::Read { path: path.to_owned(), source }
}

/// The bytes of a file.
///
/// # Errors
/// [`DatasetError::Read`].
pub(super) fn read(path: &Path) -> Result<Vec<u8>> {
    std::fs::read(path).map_err(unreadable(path))
}
