//! The input of a reconstruction: a folder of photographs, or a video.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use serde_json::{Value, json};

use super::FEWEST;
use super::error::{SfmError, io};
use super::masks;
use crate::dataset;
use crate::dataset::names::list;

/// Pictures that are read.
pub(super) const PHOTOGRAPHS: [&str; 3] = ["jpg", "jpeg", "png"];
/// Pictures that are not, and that a camera or a phone may have left.
const OTHER_PICTURES: [&str; 15] =
    ["heic", "heif", "avif", "webp", "jxl", "tif", "tiff", "bmp", "dng", "cr2", "cr3", "nef", "arw", "exr", "hdr"];
pub(super) const VIDEOS: [&str; 10] = ["mp4", "mov", "mkv", "avi", "webm", "m4v", "mts", "m2ts", "3gp", "mpg"];
/// Folders within the one that is named in which photographs are looked for if it holds none itself.
const SUBFOLDERS: [&str; 2] = ["images", "input"];

/// Photographs or a video without cameras.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Input {
    Photographs {
        /// As it was named.
        path: PathBuf,
        /// That holds the files: `path`, or `images` or `input` in it.
        folder: PathBuf,
        /// Names of the files, sorted.
        names: Vec<String>,
        /// Names of pictures in formats that are not read, sorted.
        unread: Vec<String>,
        /// Photographs that have a mask in the folder `masks` of `path`: name and mask.
        masks: Vec<(String, PathBuf)>,
    },
    Video {
        path: PathBuf,
    },
}

impl Input {
    /// The content of `path`, if it is a video or a folder of pictures and no dataset.
    pub fn find(path: &Path) -> Option<Self> {
        if path.is_file() {
            return has_extension(path, &VIDEOS).then(|| Self::Video { path: path.to_owned() });
        }
        if dataset::format(path).is_some() || path.join("colmap").is_dir() || is_begun(path) {
            return None;
        }
        let folders = std::iter::once(path.to_owned()).chain(SUBFOLDERS.map(|name| path.join(name)));
        folders.into_iter().find_map(|folder| {
            let (names, unread) = (files(&folder, &PHOTOGRAPHS), files(&folder, &OTHER_PICTURES));
            let holds_pictures = !(names.is_empty() && unread.is_empty());
            holds_pictures.then(|| {
                let masks = masks::find(path, &names);
                Self::Photographs { path: path.to_owned(), folder, names, unread, masks }
            })
        })
    }

    /// The folder of photographs or the video, as it was named.
    pub fn path(&self) -> &Path {
        match self {
            Self::Photographs { path, .. } | Self::Video { path } => path,
        }
    }

    /// The name of its dataset: that of the folder, or that of the video without extension.
    pub fn name(&self) -> Option<String> {
        let name = match self {
            Self::Photographs { path, .. } => path.file_name(),
            Self::Video { path } => path.file_stem(),
        };
        name.map(|name| name.to_string_lossy().into_owned())
    }

    /// Photographs that have a mask: name and mask.
    pub(super) fn masks(&self) -> &[(String, PathBuf)] {
        match self {
            Self::Photographs { masks, .. } => masks,
            Self::Video { .. } => &[],
        }
    }

    /// # Errors
    /// [`SfmError::TooFew`], [`SfmError::OtherFormats`].
    pub(super) fn check(&self) -> Result<(), SfmError> {
        match self {
            Self::Photographs { folder, names, unread, .. } if names.is_empty() => {
                Err(SfmError::OtherFormats { path: folder.clone(), found: list(unread) })
            }
            Self::Photographs { folder, names, .. } if names.len() < FEWEST => {
                Err(SfmError::TooFew { path: folder.clone(), found: names.len() })
            }
            _ => Ok(()),
        }
    }

    /// Names and sizes of the files, which tell whether others have taken their places.
    ///
    /// # Errors
    /// [`SfmError::File`].
    pub(super) fn fingerprint(&self) -> Result<Value, SfmError> {
        match self {
            Self::Photographs { folder, names, .. } => fingerprint(names.iter().map(|name| folder.join(name))),
            Self::Video { path } => fingerprint([path.clone()]),
        }
    }

    /// The same of the masks; `None` without any.
    ///
    /// # Errors
    /// [`SfmError::File`].
    pub(super) fn fingerprint_of_masks(&self) -> Result<Option<Value>, SfmError> {
        let masks = self.masks();
        (!masks.is_empty()).then(|| fingerprint(masks.iter().map(|(_, mask)| mask.clone()))).transpose()
    }
}

fn fingerprint(files: impl IntoIterator<Item = PathBuf>) -> Result<Value, SfmError> {
    let of = |path: PathBuf| -> Result<Value, SfmError> {
        let bytes = path.metadata().map_err(io("cannot read", &path))?.len();
        Ok(json!([path.file_name().unwrap_or_default().to_string_lossy(), bytes]))
    };
    files.into_iter().map(of).collect::<Result<Vec<Value>, _>>().map(Value::from)
}

/// Whether the folder is a dataset that [`reconstruct`](super::reconstruct) has begun.
pub fn is_begun(path: &Path) -> bool {
    path.join("sfm/steps.json").is_file()
}

pub(super) fn has_extension(path: &Path, extensions: &[&str]) -> bool {
    let extension = path.extension().map(|extension| extension.to_string_lossy().to_lowercase());
    extension.is_some_and(|extension| extensions.contains(&extension.as_str()))
}

/// Names of the files in `folder` with one of the extensions, sorted; those that begin with a dot are left out.
fn files(folder: &Path, extensions: &[&str]) -> Vec<String> {
    let mut names: Vec<String> = std::fs::read_dir(folder)
        .into_iter()
        .flatten()
        .flatten()
        .filter(|entry| has_extension(&entry.path(), extensions) && entry.path().is_file())
        .filter_map(|entry| entry.file_name().into_string().ok())
        .filter(|name| !name.starts_with('.'))
        .collect();
    names.sort();
    names
}

pub(super) fn unread_warning(unread: &[String]) -> String {
    format!("left out, for only JPEG and PNG are read: {}; convert them to JPEG to use them", list(unread))
}

/// Whether names differ in their last number only, so that their order is that in which they were taken.
pub(super) fn are_numbered(names: &[String]) -> bool {
    let prefixes: Option<BTreeSet<&str>> = names.iter().map(|name| before_last_number(name)).collect();
    prefixes.is_some_and(|prefixes| prefixes.len() == 1)
}

fn before_last_number(name: &str) -> Option<&str> {
    let stem = name.rsplit_once('.').map_or(name, |(stem, _)| stem);
    let prefix = stem.trim_end_matches(|c: char| c.is_ascii_digit());
    (prefix.len() < stem.len()).then_some(prefix)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dataset::fixtures::write_png;

    fn names(names: &[&str]) -> Vec<String> {
        names.iter().map(|name| (*name).to_owned()).collect()
    }

    #[test]
    fn photographs_are_found_in_a_folder_or_in_one_below() {
        let folder = tempfile::tempdir().unwrap();
        let at = folder.path();
        assert_eq!(Input::find(at), None);
        std::fs::write(at.join("notes.txt"), "").unwrap();
        assert_eq!(Input::find(at), None);
        for name in ["b.JPG", "a.png", ".hidden.png", "c.heic"] {
            std::fs::create_dir_all(at.join("images")).unwrap();
            std::fs::write(at.join("images").join(name), "").unwrap();
        }
        let found = Input::find(at).unwrap();
        let (path, folder) = (at.to_owned(), at.join("images"));
        let (read, unread) = (names(&["a.png", "b.JPG"]), names(&["c.heic"]));
        assert_eq!(found, Input::Photographs { path, folder, names: read, unread, masks: Vec::new() });
        assert_eq!(found.name().unwrap(), at.file_name().unwrap().to_str().unwrap());
        assert!(matches!(found.check(), Err(SfmError::TooFew { found: 2, .. })));
        std::fs::write(at.join("z.jpeg"), "").unwrap();
        assert!(matches!(Input::find(at), Some(Input::Photographs { folder, .. }) if folder == at));
        std::fs::create_dir(at.join("sparse")).unwrap();
        assert_eq!(Input::find(at), None, "it is a dataset");
    }

    #[test]
    fn masks_lie_in_a_folder_of_the_one_that_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let at = folder.path();
        for name in ["images/a.jpg", "images/b.jpg", "images/c.jpg"] {
            write_png(&at.join(name).with_extension("png"), 2, 2, [0; 3]);
            std::fs::rename(at.join(name).with_extension("png"), at.join(name)).unwrap();
        }
        write_png(&at.join("masks/a.jpg.png"), 2, 2, [0; 3]);
        write_png(&at.join("masks/b.png"), 2, 2, [0; 3]);
        write_png(&at.join("masks/stranger.png"), 2, 2, [0; 3]);
        let found = Input::find(at).unwrap();
        let expected = [("a.jpg", "a.jpg.png"), ("b.jpg", "b.png")];
        let expected = expected.map(|(name, mask)| (name.to_owned(), at.join("masks").join(mask)));
        assert_eq!(found.masks(), expected);
        assert_eq!(found.fingerprint_of_masks().unwrap().unwrap()[1][0], "b.png");
    }

    #[test]
    fn other_formats_are_named() {
        let folder = tempfile::tempdir().unwrap();
        for name in ["IMG_1.HEIC", "lamp.exr", "room.hdr"] {
            std::fs::write(folder.path().join(name), "").unwrap();
        }
        let message = Input::find(folder.path()).unwrap().check().unwrap_err().to_string();
        assert!(
            message.contains("IMG_1.HEIC, lamp.exr, room.hdr") && message.contains("convert them to JPEG"),
            "{message}"
        );
    }

    #[test]
    fn videos_are_known_by_their_extension() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("walk 1.MP4");
        assert_eq!(Input::find(&path), None, "it is not there");
        std::fs::write(&path, "12345").unwrap();
        let found = Input::find(&path).unwrap();
        assert_eq!((found.path(), found.name().unwrap().as_str()), (path.as_path(), "walk 1"));
        assert_eq!(found.fingerprint().unwrap(), json!([["walk 1.MP4", 5]]));
    }

    #[test]
    fn numbered_names_differ_in_their_last_number_only() {
        assert!(are_numbered(&names(&["IMG_9.jpg", "IMG_10.jpg"])));
        assert!(are_numbered(&names(&["20240212_003919.jpg", "20240212_003921.jpg"])));
        assert!(!are_numbered(&names(&["IMG_9.jpg", "DSC_10.jpg"])));
        assert!(!are_numbered(&names(&["door.jpg", "window.jpg"])));
    }
}
