//! The folder of a dataset in the making:
//!
//! ```text
//! images/            the photographs, as links where the file system allows, or the frames of the video
//! masks/             their masks, if there are any, and those that were put there by hand
//! sparse/0/          the model; it is there once all is done
//! sfm/STEP.log       what the program of a step said
//! sfm/masks/         the masks as COLMAP reads them
//! sfm/OPTIONS.db     features and matches
//! sfm/models/N/      every model that came out
//! sfm/lock           held by the process that is at work
//! ```

use std::fs::File;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use dpges_core::scene::atomic::{lock, make_folder};

use super::error::{SfmError, io};
use super::input::{Input, MASKS, is_begun};
use super::masks::file_name;
use super::step::Step;
use crate::names::{in_folder, list};

/// Its end is that of the names of databases.
const DATABASE: &str = ".db";

pub(super) struct Workspace {
    pub root: PathBuf,
    pub images: PathBuf,
    pub masks: PathBuf,
    /// The model in use is in `0` of it.
    pub sparse: PathBuf,
    pub models: PathBuf,
    _lock: File,
}

/// Whether the folder is a dataset that is finished.
pub(super) fn is_finished(path: &Path) -> bool {
    is_begun(path) && path.join("sparse/0").is_dir()
}

impl Workspace {
    /// Makes the folder, or takes one that was made before, as soon as no other process is at work in it.
    ///
    /// # Errors
    /// [`SfmError::Foreign`], [`SfmError::File`].
    pub fn open(root: &Path) -> Result<Self, SfmError> {
        let others = file_names(root)?;
        if !others.is_empty() && !is_begun(root) {
            return Err(SfmError::Foreign { dataset: root.to_owned(), found: list(&others) });
        }
        let work = root.join("sfm");
        make_folder(&work)?;
        let lock = lock(&work.join("lock"), || tracing::info!("another process is at work in {}", root.display()))?;
        Ok(Self {
            root: root.to_owned(),
            images: root.join("images"),
            masks: root.join(MASKS),
            sparse: root.join("sparse"),
            models: work.join("models"),
            _lock: lock,
        })
    }

    pub fn log(&self, step: Step) -> PathBuf {
        self.work(&format!("{step}.log"))
    }

    /// A file or folder of intermediate results.
    pub fn work(&self, name: &str) -> PathBuf {
        self.root.join("sfm").join(name)
    }

    /// The database of features that were found with `options`, which make up its name. COLMAP leaves out of a step what it finds
    /// there of a photograph or a pair.
    pub fn database(&self, options: &str) -> PathBuf {
        self.work(&format!("{options}{DATABASE}"))
    }

    /// Removes all but the masks.
    pub fn forget(&self) -> Result<(), SfmError> {
        [&self.sparse, &self.models, &self.images].into_iter().try_for_each(|path| remove(path))?;
        let work = self.root.join("sfm");
        let databases = file_names(&work)?.into_iter().filter(|name| name.contains(DATABASE));
        databases.map(|name| work.join(name)).try_for_each(|path| remove(&path))
    }

    /// Names of the files in `images`, sorted.
    pub fn picture_names(&self) -> Result<Vec<String>, SfmError> {
        file_names(&self.images)
    }

    /// Their paths.
    pub fn pictures(&self) -> Result<Vec<PathBuf>, SfmError> {
        Ok(self.picture_names()?.into_iter().map(|name| self.images.join(name)).collect())
    }

    /// An empty folder `sfm/NAME`.
    pub fn empty_folder(&self, name: &str) -> Result<PathBuf, SfmError> {
        let path = self.work(name);
        remove(&path)?;
        make_folder(&path)?;
        Ok(path)
    }

    /// Makes `images` of the files `names` in `folder`.
    pub fn link_pictures(&self, folder: &Path, names: &[String]) -> Result<(), SfmError> {
        let part = self.empty_folder("links.part")?;
        for name in names {
            let path = folder.join(name);
            // a link to a symbolic link would break if that is relative
            let original = path.canonicalize().map_err(io("cannot read", &path))?;
            let link = part.join(name);
            if std::fs::hard_link(&original, &link).is_err() {
                copy(&original, &link)?;
            }
        }
        replace(&part, &self.images)
    }

    /// Whether the dataset has the photographs and masks of `input`, by their names. Frames of a video are not compared.
    ///
    /// # Errors
    /// [`SfmError::File`].
    pub fn holds(&self, input: &Input) -> Result<bool, SfmError> {
        let Input::Photographs { names, masks, .. } = input else { return Ok(true) };
        let has_mask = |(name, _): &(String, PathBuf)| self.mask_of(name).is_some();
        Ok(self.picture_names()? == *names && masks.iter().all(has_mask))
    }

    /// The mask of a photograph in the dataset.
    pub fn mask_of(&self, photograph: &str) -> Option<PathBuf> {
        let names = [PathBuf::from(file_name(photograph)), Path::new(photograph).with_extension("png")];
        names.into_iter().map(|name| self.masks.join(name)).find(|path| path.is_file())
    }

    /// Puts `masks` of photographs, by their names, into the dataset. Returns the names of the photographs that have another one
    /// there, which stays: somebody may have made it by hand.
    pub fn copy_masks(&self, masks: &[(String, PathBuf)]) -> Result<Vec<String>, SfmError> {
        let mut kept = Vec::new();
        for (photograph, mask) in masks {
            let read = |path: &Path| std::fs::read(path).map_err(io("cannot read", path));
            match self.mask_of(photograph) {
                Some(own) if read(&own)? != read(mask)? => kept.push(photograph.clone()),
                Some(_) => {}
                None => {
                    make_folder(&self.masks)?;
                    copy(mask, &self.masks.join(file_name(photograph)))?;
                }
            }
        }
        Ok(kept)
    }
}

pub(super) fn copy(from: &Path, to: &Path) -> Result<(), SfmError> {
    std::fs::copy(from, to).map_err(io("cannot write", to))?;
    Ok(())
}

/// Puts folder `new` in the place of `old`, which need not exist.
pub(super) fn replace(new: &Path, old: &Path) -> Result<(), SfmError> {
    remove(old)?;
    std::fs::rename(new, old).map_err(io("cannot write", old))
}

/// Removes a file or a folder with all that it holds, if it is there.
pub(super) fn remove(path: &Path) -> Result<(), SfmError> {
    let result = if path.is_dir() { std::fs::remove_dir_all(path) } else { std::fs::remove_file(path) };
    if_there(result).map_err(io("cannot remove", path))?;
    Ok(())
}

/// Sorted; none if there is no such folder.
pub(super) fn file_names(folder: &Path) -> Result<Vec<String>, SfmError> {
    Ok(if_there(in_folder(folder)).map_err(io("cannot read folder", folder))?.unwrap_or_default())
}

/// `None` if that which was sought is not there.
fn if_there<T>(result: std::io::Result<T>) -> std::io::Result<Option<T>> {
    match result {
        Err(error) if error.kind() == ErrorKind::NotFound => Ok(None),
        result => result.map(Some),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures::assert_says;

    #[test]
    fn a_folder_with_other_files_is_left_alone() {
        let folder = tempfile::tempdir().unwrap();
        let root = folder.path().join("new/set");
        drop(Workspace::open(&root).unwrap());
        std::fs::write(root.join("notes.txt"), "").unwrap();
        drop(Workspace::open(&root).unwrap());
        std::fs::remove_dir_all(root.join("sfm")).unwrap();
        assert_says(Workspace::open(&root).err().unwrap(), &["notes.txt", "name another"]);
        assert!(!root.join("sfm").exists());
    }

    #[test]
    fn pictures_are_linked_and_replaced_as_a_whole() {
        let folder = tempfile::tempdir().unwrap();
        let photographs = folder.path();
        let both = ["a.jpg", "b.jpg"].map(str::to_owned);
        both.iter().for_each(|name| std::fs::write(photographs.join(name), name).unwrap());
        let workspace = Workspace::open(&folder.path().join("set")).unwrap();
        workspace.link_pictures(photographs, &both).unwrap();
        assert_eq!(workspace.picture_names().unwrap(), both);
        assert_eq!(std::fs::read(&workspace.pictures().unwrap()[1]).unwrap(), b"b.jpg");
        workspace.link_pictures(photographs, &both[1..]).unwrap();
        assert_eq!(workspace.picture_names().unwrap(), both[1..]);
        assert_says(workspace.link_pictures(photographs, &["c.jpg".to_owned()]).unwrap_err(), &["c.jpg"]);
        assert_eq!(workspace.picture_names().unwrap(), both[1..], "the old ones stay");
    }
}
