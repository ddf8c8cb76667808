//! Errors in datasets on disk. Every message names the file, what was found there, and the remedy.

use std::path::{Path, PathBuf};

use glam::DVec3;

pub type Result<T, E = DatasetError> = std::result::Result<T, E>;

#[derive(Debug, thiserror::Error)]
pub enum DatasetError {
    #[error(
        "{path} is no dataset this program reads: looked for sparse/ (COLMAP), transforms_train.json (Blender), \
         transforms.json (nerfstudio) and cameras of Metashape, RealityScan, OpenSfM and Bundler, found {found}; point to the \
         folder that holds one of them"
    )]
    UnknownFormat { path: PathBuf, found: String },
    #[error(
        "{path} holds no COLMAP model: looked for cameras.bin or cameras.txt in it and in its subfolders, \
         found {found}; point to the folder above sparse/0"
    )]
    NoModel { path: PathBuf, found: String },
    #[error("{path} is missing, and {alternative}; export the model again")]
    MissingModelFile { path: PathBuf, alternative: &'static str },
    #[error("cannot read {path}: {source}")]
    Read { path: PathBuf, source: std::io::Error },
    #[error(
        "{path} is truncated or corrupt: {what} needs at least {needed} bytes, {left} are left; copy or export it again"
    )]
    Truncated { path: PathBuf, what: String, needed: u64, left: usize },
    #[error("{path}: {what} is {found}, expected {expected}; repair the entry or remove it")]
    Malformed { path: PathBuf, what: String, found: String, expected: String },
    #[error("{path} is not the JSON of a file of cameras: {reason}")]
    Json { path: PathBuf, reason: String },
    #[error("{path} is not XML: {source}; copy or export it again")]
    Xml { path: PathBuf, source: roxmltree::Error },
    #[error("{path}: none of its {all} cameras has a position; align the photographs, then export the cameras again")]
    NotAligned { path: PathBuf, all: usize },
    #[error("{path} is not a readable PLY point cloud: {source}; export it again or remove `ply_file_path`")]
    Ply { path: PathBuf, source: serde_ply::DeserializeError },
    /// See `formats::cloud`.
    #[error("measured points {path} (`data.points`) {reason}")]
    MeasuredPoints { path: PathBuf, reason: String },
    #[error(
        "{path}: camera model {model} of {camera} is not supported: {reason}; \
         convert it to another model or undistort the photographs to PINHOLE first"
    )]
    CameraModel { path: PathBuf, camera: String, model: String, reason: &'static str },
    #[error(
        "{path}: view `{view}` is a panorama of {}x{} px; one of all directions is twice as wide as high: pad {image} by what it \
         lacks and mask that, or give the view the camera model of its picture",
        found[0], found[1]
    )]
    Panorama { path: PathBuf, image: PathBuf, view: String, found: [usize; 2] },
    #[error(
        "{path}: the distortion of view `{view}` cannot be undone with a pinhole camera of half to twice its focal \
         length; check its coefficients, undistort the photographs first, or use them as they are (`data.undistort` = false)"
    )]
    Distortion { path: PathBuf, view: String },
    #[error("{path}: view `{view}`: {source}; repair the view or remove it")]
    Camera { path: PathBuf, view: String, source: Box<dpges_core::Error> },
    #[error(
        "{path}: view `{view}` has neither `fl_x`, `fl_y`, `camera_angle_x` nor `camera_angle_y`; add one for the file or for the frame"
    )]
    NoFocalLength { path: PathBuf, view: String },
    #[error(
        "{image} is the photograph of two views that contradict each other: `{}` in {} at {}, `{}` in {} at {}; their poses or \
         intrinsics differ, remove the wrong one",
        views[0].0, views[0].1.display(), views[0].2, views[1].0, views[1].1.display(), views[1].2
    )]
    Contradiction {
        image: String,
        /// Name, file of the pose, and centre of the camera in the world.
        views: Box<[(String, PathBuf, DVec3); 2]>,
    },
    #[error("{path}: no views; a dataset needs at least one photograph with a pose")]
    NoViews { path: PathBuf },
    #[error("{path}: no training views, all {held_out} are held out; hold out fewer (`test_every`)")]
    NoTrainingViews { path: PathBuf, held_out: usize },
    #[error("{path}: no test views: {reason}; set `test_every` = 0 to train without held-out views")]
    NoTestViews { path: PathBuf, reason: &'static str },
    #[error(
        "{path} and others are missing, {missing} of {all} photographs; {described_in} names them: restore them, or remove their views"
    )]
    MissingMost { path: PathBuf, missing: usize, all: usize, described_in: PathBuf },
    #[error(
        "{path} holds cameras of {program}, which are not read; export them for COLMAP (cameras.txt, images.txt and points3D.txt \
         in sparse/0), name the file itself if it is one of transforms, or have cameras found anew: `dpges sfm {folder}`"
    )]
    ForeignCameras { path: PathBuf, program: &'static str, folder: PathBuf },
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
    #[error(
        "{path} has no depth maps, but {found}; write them as grey PNGs of 16 bits that are called like photographs, or set \
         `data.depth` = \"none\" to train without them"
    )]
    NoDepth { path: PathBuf, found: String },
    #[error("depth map {path} is an image of type {found}, expected {expected}; export it again")]
    DepthType { path: PathBuf, found: String, expected: &'static str },
    #[error("folder {path} is missing, there are {available}; use an image scale that exists, or cap the resolution")]
    MissingScale { path: PathBuf, available: String },
    #[error("image {path} is a picture of format {format}, which is not read; convert it and its like to JPEG or PNG")]
    PictureFormat { path: PathBuf, format: &'static str },
    #[error(
        "image {path} is cut short: it ends at byte {bytes}, before its last line; copy it again, or remove the view"
    )]
    CutShort { path: PathBuf, bytes: usize },
    #[error(
        "image {path} is damaged, and only a part of it can be decoded ({reason}); copy it again, or remove the view"
    )]
    Damaged { path: PathBuf, reason: String },
    #[error(
        "image {path} is {}x{} px, and its EXIF orientation {orientation} turns it to the {}x{} of its camera in {described_in}; \
         turn the pixels (`mogrify -auto-orient`), for what EXIF says is ignored",
        found[0], found[1], found[1], found[0]
    )]
    Orientation { path: PathBuf, found: [usize; 2], orientation: u32, described_in: PathBuf },
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
    pub(super) fn malformed(path: &Path, what: String, found: impl ToString, expected: impl ToString) -> Self {
        Self::Malformed { path: path.to_owned(), what, found: found.to_string(), expected: expected.to_string() }
    }
}

/// Bytes around the place of an error of JSON that tell why it is none.
const AROUND: usize = 9;

/// The error of a `text` that is not the JSON it should be.
pub(super) fn not_json(path: &Path, text: &str, error: &serde_json::Error) -> DatasetError {
    let line = text.lines().nth(error.line().saturating_sub(1)).unwrap_or_default().as_bytes();
    let at = error.column().min(line.len());
    let around = String::from_utf8_lossy(&line[at.saturating_sub(AROUND)..(at + AROUND).min(line.len())]);
    let reason = if text.trim().is_empty() {
        "it is empty; export it again".to_owned()
    } else if error.is_syntax() && ["NaN", "nan", "Inf", "inf"].iter().any(|word| around.contains(word)) {
        format!("{error}; NaN and infinity are not JSON")
    } else {
        error.to_string()
    };
    DatasetError::Json { path: path.to_owned(), reason }
}

/// An error of the file system as [`DatasetError::Read`], for `map_err`.
pub(super) fn unreadable(path: &Path) -> impl FnOnce(std::io::Error) -> DatasetError {
    |source| DatasetError::Read { path: path.to_owned(), source }
}

/// The text of a file, without a byte order mark: as UTF-8, or as UTF-16 if its mark says so.
///
/// # Errors
/// [`DatasetError::Read`].
pub(super) fn read_text(path: &Path) -> Result<String> {
    Ok(text_of(&read(path)?))
}

/// The text of `bytes` in UTF-8, or in UTF-16 with its mark.
pub(super) fn text_of(bytes: &[u8]) -> String {
    let of_utf16 = |of: fn([u8; 2]) -> u16| {
        String::from_utf16_lossy(&bytes[2..].as_chunks::<2>().0.iter().map(|&pair| of(pair)).collect::<Vec<u16>>())
    };
    match bytes {
        [0xff, 0xfe, ..] => of_utf16(u16::from_le_bytes),
        [0xfe, 0xff, ..] => of_utf16(u16::from_be_bytes),
        [0xef, 0xbb, 0xbf, text @ ..] => String::from_utf8_lossy(text).into_owned(),
        text => String::from_utf8_lossy(text).into_owned(),
    }
}

/// The bytes of a file.
///
/// # Errors
/// [`DatasetError::Read`].
pub(super) fn read(path: &Path) -> Result<Vec<u8>> {
    std::fs::read(path).map_err(unreadable(path))
}
