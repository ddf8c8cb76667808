//! The input of a reconstruction: a folder of photographs, or a video.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use super::FEWEST;
use super::error::SfmError;
use crate::companions::Companions;
use crate::conventions::{self, READ, UNREAD};
use crate::folder::Folder;
use crate::names::{in_folder, list};

pub(super) const VIDEOS: [&str; 10] = ["mp4", "mov", "mkv", "avi", "webm", "m4v", "mts", "m2ts", "3gp", "mpg"];
/// Folders within the one that is named in which photographs are looked for if it holds none itself.
const SUBFOLDERS: [&str; 2] = ["images", "input"];

/// The folder of masks, beside photographs and in a dataset.
pub(super) const MASKS: &str = "masks";

/// Photographs or a video without cameras.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Input {
    Photographs {
        /// As it was named.
        path: PathBuf,
        /// That holds the files: `path`, or `images` or `input` in it.
        folder: PathBuf,
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
    /// The content of `path`, if it is a video or a folder of pictures and no dataset; nor one of another program, whose cameras
    /// would be lost, unless they are to be `anew`.
    pub fn find(path: &Path, anew: bool) -> Option<Self> {
        if path.is_file() {
            return has_extension(path, &VIDEOS).then(|| Self::Video { path: path.to_owned() });
        }
        let is_dataset = crate::format(path).is_some_and(|format| !anew || !format.is_guest());
        if is_dataset || is_begun(path) || (!anew && crate::foreign(path).is_some()) {
            return None;
        }
        let folders = std::iter::once(path.to_owned()).chain(SUBFOLDERS.map(|name| path.join(name)));
        folders.into_iter().find_map(|folder| {
            let (names, unread) = (files(&folder, &READ), files(&folder, &UNREAD));
            let holds_pictures = !(names.is_empty() && unread.is_empty());
            holds_pictures.then(|| {
                let below = Folder::read(path);
                let masks = Companions::new(&below, conventions::MASKS, None);
                let mask_of = |name: &String| Some((name.clone(), masks.of(&folder.join(name))?));
                let masks = names.iter().filter_map(mask_of).collect();
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
}

/// Whether the folder is a dataset that [`reconstruct`](super::reconstruct) has begun.
pub fn is_begun(path: &Path) -> bool {
    path.join("sfm/lock").is_file()
}

pub(super) fn has_extension(path: &Path, extensions: &[&str]) -> bool {
    let extension = path.extension().map(|extension| extension.to_string_lossy().to_lowercase());
    extension.is_some_and(|extension| extensions.contains(&extension.as_str()))
}

/// Names of the files in `folder` with one of the extensions, sorted; those that begin with a dot are left out.
fn files(folder: &Path, extensions: &[&str]) -> Vec<String> {
    let mut names = in_folder(folder).unwrap_or_default();
    names.retain(|name| {
        let path = folder.join(name);
        !name.starts_with('.') && has_extension(&path, extensions) && path.is_file()
    });
    names
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
    use crate::fixtures::assert_says;

    fn find(path: &Path) -> Option<Input> {
        Input::find(path, false)
    }

    fn names(names: &[&str]) -> Vec<String> {
        names.iter().map(|name| (*name).to_owned()).collect()
    }

    /// A folder with empty files of these names.
    fn folder(names: &[&str]) -> tempfile::TempDir {
        let folder = tempfile::tempdir().unwrap();
        for name in names {
            let path = folder.path().join(name);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(path, "").unwrap();
        }
        folder
    }

    #[test]
    fn photographs_are_found_in_a_folder_or_in_one_below() {
        assert_eq!(find(folder(&[]).path()), None);
        assert_eq!(find(folder(&["notes.txt"]).path()), None);
        let files = ["notes.txt", "images/b.JPG", "images/a.png", "images/.hidden.png", "images/c.heic"];
        let folder = folder(&files);
        let at = folder.path();
        let found = find(at).unwrap();
        let (path, folder) = (at.to_owned(), at.join("images"));
        let (read, unread) = (names(&["a.png", "b.JPG"]), names(&["c.heic"]));
        assert_eq!(found, Input::Photographs { path, folder, names: read, unread, masks: Vec::new() });
        assert_eq!(found.name().unwrap(), at.file_name().unwrap().to_str().unwrap());
        assert!(matches!(found.check(), Err(SfmError::TooFew { found: 2, .. })));
        std::fs::write(at.join("z.jpeg"), "").unwrap();
        assert!(matches!(find(at), Some(Input::Photographs { folder, .. }) if folder == at));
        std::fs::create_dir(at.join("sparse")).unwrap();
        assert_eq!(find(at), None, "it is a dataset");
    }

    #[test]
    fn masks_lie_in_a_folder_of_the_one_that_is_named() {
        let photographs = ["images/a.jpg", "images/b.jpg", "images/c.jpg"];
        let masks = ["masks/a.jpg.png", "masks/b.png", "masks/stranger.png"];
        let folder = folder(&[photographs, masks].concat());
        let found = find(folder.path()).unwrap();
        let expected = [("a.jpg", masks[0]), ("b.jpg", masks[1])];
        assert_eq!(found.masks(), expected.map(|(name, mask)| (name.to_owned(), folder.path().join(mask))));
    }

    #[test]
    fn other_formats_are_named() {
        let folder = folder(&["IMG_1.HEIC", "lamp.exr", "room.hdr"]);
        let error = find(folder.path()).unwrap().check().unwrap_err();
        assert_says(error, &["IMG_1.HEIC, lamp.exr, room.hdr", "convert them to JPEG"]);
    }

    #[test]
    fn videos_are_known_by_their_extension() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("walk 1.MP4");
        assert_eq!(find(&path), None, "it is not there");
        std::fs::write(&path, "12345").unwrap();
        let found = find(&path).unwrap();
        assert_eq!((found.path(), found.name().unwrap().as_str()), (path.as_path(), "walk 1"));
    }
}
