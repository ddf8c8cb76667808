//! The folder of a dataset in the making:
//!
//! ```text
//! images/            the photographs, as links where the file system allows, or the frames of the video
//! masks/             their masks, if there are any, and those that were put there by hand
//! sparse/0/          the model; it is there once all is done
//! sfm/steps.json     which steps are done, how long they took, and what they depend on
//! sfm/STEP.log       what the program of a step said
//! sfm/masks/         the masks as COLMAP reads them
//! sfm/masks_made/    the masks as they were put into `masks`: others there were made by hand
//! sfm/database.db    features and matches
//! sfm/models/N/      every model that came out
//! sfm/lock           held by the process that is at work
//! ```

use std::collections::BTreeMap;
use std::fs::{File, TryLockError};
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::time::Duration;

use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::error::{SfmError, io};
use super::input::MASKS;
use super::masks::file_name;
use super::step::Step;
use crate::dataset::mask_called_like;
use crate::dataset::names::{in_folder, list};
use crate::run::folder::write_json;

/// Folder of the masks that were put into `masks`, below that of intermediate results.
const MADE: &str = "masks_made";
const LOCK_TRIES: usize = 5;
const LOCK_PAUSE: Duration = Duration::from_millis(50);

pub(super) struct Workspace {
    pub root: PathBuf,
    pub images: PathBuf,
    pub masks: PathBuf,
    /// The model in use is in `0` of it.
    pub sparse: PathBuf,
    pub database: PathBuf,
    pub models: PathBuf,
    record: Record,
    _lock: File,
}

#[derive(Clone, Debug, Default, Serialize, Deserialize)]
struct Record {
    steps: BTreeMap<Step, Entry>,
}

#[derive(Clone, Debug, Serialize, Deserialize)]
struct Entry {
    /// The inputs of the result.
    key: Value,
    /// How long it took, s. `None` while it is not done.
    seconds: Option<f64>,
}

/// Takes the lock unless another process holds it. On a file system without locks it is up to the user.
fn is_held_by_another(lock: &File) -> bool {
    // a program that another thread is just starting holds the files of this one for a moment
    (0..LOCK_TRIES).all(|_| {
        let is_held = matches!(lock.try_lock(), Err(TryLockError::WouldBlock));
        if is_held {
            std::thread::sleep(LOCK_PAUSE);
        }
        is_held
    })
}

impl Workspace {
    /// Makes the folder, or takes one that was made before.
    ///
    /// # Errors
    /// [`SfmError::Foreign`], [`SfmError::Busy`], [`SfmError::Record`], [`SfmError::File`].
    pub fn open(root: &Path) -> Result<Self, SfmError> {
        let work = root.join("sfm");
        let others: Vec<String> = file_names(root)?.into_iter().filter(|name| name != "sfm").collect();
        if !others.is_empty() && !work.join("steps.json").is_file() {
            return Err(SfmError::Foreign { dataset: root.to_owned(), found: list(&others) });
        }
        make_folder(&work)?;
        let path = work.join("lock");
        let lock = File::create(&path).map_err(io("cannot write", &path))?;
        if is_held_by_another(&lock) {
            return Err(SfmError::Busy { dataset: root.to_owned() });
        }
        Ok(Self {
            root: root.to_owned(),
            images: root.join("images"),
            masks: root.join(MASKS),
            sparse: root.join("sparse"),
            database: work.join("database.db"),
            models: work.join("models"),
            record: read_record(&work.join("steps.json"))?,
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

    /// Whether there is a model, and nothing is left to do.
    pub fn is_finished(&self) -> bool {
        self.sparse.is_dir() && self.record.steps.get(&Step::Model).is_some_and(|entry| entry.seconds.is_some())
    }

    /// Whether `step` has been done, depending on `key`. Files that only later steps need may have been removed since.
    pub fn is_done(&self, step: Step, key: &Value) -> bool {
        let is_there = match step {
            Step::Pictures => self.images.is_dir(),
            Step::Model => self.sparse.is_dir(),
            Step::Features | Step::Matches | Step::Mapping => true,
        };
        is_there && self.record.steps.get(&step).is_some_and(|entry| entry.key == *key && entry.seconds.is_some())
    }

    /// `step`, or the step before it whose result it needs and that has been removed.
    pub fn with_what_it_needs(&self, step: Step) -> Step {
        let step = if step > Step::Mapping && !self.models.is_dir() { Step::Mapping } else { step };
        if step > Step::Features && step <= Step::Mapping && !self.database.is_file() { Step::Features } else { step }
    }

    /// Notes that `step` is not done, nor those after it, and removes what they left, unless this step goes on.
    pub fn begin(&mut self, step: Step, key: Value) -> Result<(), SfmError> {
        // the models of an interrupted mapping are not kept
        let goes_on = step != Step::Mapping && self.record.steps.get(&step).is_some_and(|entry| entry.key == key);
        if step == Step::Pictures && !goes_on {
            self.remove_made_masks()?;
        }
        self.record.steps.retain(|&other, _| other < step);
        self.record.steps.insert(step, Entry { key, seconds: None });
        self.save()?;
        for step in Step::ALL.into_iter().filter(|&other| other > step || (other == step && !goes_on)) {
            self.remove_result(step)?;
        }
        if step == Step::Mapping { make_folder(&self.models) } else { Ok(()) }
    }

    /// Notes that `step` is done.
    pub fn end(&mut self, step: Step, seconds: f64) -> Result<(), SfmError> {
        if let Some(entry) = self.record.steps.get_mut(&step) {
            entry.seconds = Some(seconds);
        }
        self.save()
    }

    /// The steps that are done, with the time each took, s.
    pub fn seconds(&self) -> Vec<(Step, f64)> {
        self.record.steps.iter().filter_map(|(&step, entry)| Some((step, entry.seconds?))).collect()
    }

    fn save(&self) -> Result<(), SfmError> {
        Ok(write_json(&self.work("steps.json"), &self.record)?)
    }

    /// `images` stays until others take its place.
    fn remove_result(&self, step: Step) -> Result<(), SfmError> {
        match step {
            Step::Pictures | Step::Matches => Ok(()),
            Step::Features => ["database.db", "database.db-wal", "database.db-shm"]
                .iter()
                .try_for_each(|name| remove(&self.work(name))),
            Step::Mapping => remove(&self.models),
            Step::Model => remove(&self.sparse),
        }
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

    /// Puts `masks` of photographs, by their names, into the dataset, in place of those that were put there before. Returns
    /// the names of the photographs that have one there which was made by hand, and keep it.
    pub fn copy_masks(&self, masks: &[(String, PathBuf)]) -> Result<Vec<String>, SfmError> {
        self.remove_made_masks()?;
        let (folder, made) = (&self.masks, self.empty_folder(MADE)?);
        make_folder(folder)?;
        let mut kept = Vec::new();
        for (photograph, mask) in masks {
            if mask_called_like(Path::new(photograph), folder).is_some() {
                kept.push(photograph.clone());
                continue;
            }
            let name = file_name(photograph);
            // in this order: a mask without the other would count as made by hand
            copy(mask, &made.join(&name))?;
            copy(mask, &folder.join(&name))?;
        }
        Ok(kept)
    }

    /// Removes the masks that [`copy_masks`](Self::copy_masks) has made, unless they were changed since.
    fn remove_made_masks(&self) -> Result<(), SfmError> {
        let (folder, made) = (&self.masks, self.work(MADE));
        for name in file_names(&made)? {
            let (made, found) = (std::fs::read(made.join(&name)), std::fs::read(folder.join(&name)));
            if made.ok().zip(found.ok()).is_some_and(|(made, found)| made == found) {
                remove(&folder.join(&name))?;
            }
        }
        remove(&made)?;
        // only if nothing is left in it
        _ = std::fs::remove_dir(folder);
        Ok(())
    }
}

pub(super) fn make_folder(path: &Path) -> Result<(), SfmError> {
    std::fs::create_dir_all(path).map_err(io("cannot make folder", path))
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

fn read_record(path: &Path) -> Result<Record, SfmError> {
    let Some(text) = if_there(std::fs::read_to_string(path)).map_err(io("cannot read", path))? else {
        return Ok(Record::default());
    };
    serde_json::from_str(&text).map_err(|error| SfmError::Record { path: path.to_owned(), reason: error.to_string() })
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
    use serde_json::json;

    use super::*;
    use crate::dataset::fixtures::assert_says;

    /// The message of the error of a folder that is not taken.
    fn refusal(root: &Path) -> String {
        Workspace::open(root).err().expect("it was taken").to_string()
    }

    #[test]
    fn a_folder_with_other_files_and_one_in_use_are_left_alone() {
        let folder = tempfile::tempdir().unwrap();
        let root = folder.path().join("new/set");
        let first = Workspace::open(&root).unwrap();
        assert_says(refusal(&root), &["another process is at work"]);
        drop(first);
        std::fs::write(root.join("thesis.txt"), "").unwrap();
        assert_says(refusal(&root), &["thesis.txt", "name another"]);
        std::fs::write(root.join("sfm/steps.json"), "{").unwrap();
        assert_says(refusal(&root), &["steps.json", "remove the folder"]);
    }

    #[test]
    fn a_step_that_goes_on_keeps_its_result_and_one_that_is_done_anew_does_not() {
        let folder = tempfile::tempdir().unwrap();
        let mut workspace = Workspace::open(folder.path()).unwrap();
        let key = |camera: &str| json!({ "camera": camera });
        workspace.begin(Step::Features, key("a")).unwrap();
        std::fs::write(&workspace.database, "half").unwrap();
        assert!(!workspace.is_done(Step::Features, &key("a")));
        drop(workspace);

        let mut workspace = Workspace::open(folder.path()).unwrap();
        workspace.begin(Step::Features, key("a")).unwrap();
        assert!(workspace.database.is_file(), "it goes on");
        workspace.end(Step::Features, 1.5).unwrap();
        assert!(workspace.is_done(Step::Features, &key("a")) && !workspace.is_done(Step::Features, &key("b")));
        workspace.begin(Step::Mapping, Value::Null).unwrap();
        std::fs::create_dir(workspace.models.join("7")).unwrap();
        workspace.begin(Step::Mapping, Value::Null).unwrap();
        assert!(file_names(&workspace.models).unwrap().is_empty(), "models of an interrupted mapping are not kept");
        workspace.end(Step::Mapping, 2.0).unwrap();
        std::fs::create_dir(&workspace.sparse).unwrap();
        assert!(!workspace.is_finished(), "it was interrupted before it noted that the model is there");
        assert_eq!(workspace.seconds(), [(Step::Features, 1.5), (Step::Mapping, 2.0)]);

        workspace.begin(Step::Features, key("b")).unwrap();
        let left = [&workspace.database, &workspace.models, &workspace.sparse].map(|path| path.exists());
        assert_eq!((left, workspace.seconds()), ([false; 3], Vec::new()));
    }

    #[test]
    fn masks_made_by_hand_are_neither_removed_nor_replaced() {
        let folder = tempfile::tempdir().unwrap();
        let workspace = Workspace::open(&folder.path().join("set")).unwrap();
        let copy_masks = |text: &str| -> Vec<String> {
            let path = folder.path().join("given.png");
            std::fs::write(&path, text).unwrap();
            let masks = ["a.b.jpg", "b.jpg", "c.jpg"].map(|name| (name.to_owned(), path.clone()));
            workspace.copy_masks(&masks).unwrap()
        };
        let there = || -> Vec<String> {
            let names = file_names(&workspace.masks).unwrap().into_iter();
            names
                .map(|name| format!("{name} {}", std::fs::read_to_string(workspace.masks.join(&name)).unwrap()))
                .collect()
        };
        assert_eq!(copy_masks("old"), [""; 0]);
        assert_eq!(there(), ["a.b.jpg.png old", "b.jpg.png old", "c.jpg.png old"]);
        // one is changed by hand, one is replaced by one that is called otherwise, one is added
        std::fs::remove_file(workspace.masks.join("c.jpg.png")).unwrap();
        let own = ["a.b.jpg.png", "c.png", "d.png"].map(|name| workspace.masks.join(name));
        own.iter().for_each(|path| std::fs::write(path, "own").unwrap());
        assert_eq!(copy_masks("new"), ["a.b.jpg", "c.jpg"]);
        assert_eq!(there(), ["a.b.jpg.png own", "b.jpg.png new", "c.png own", "d.png own"]);
        workspace.remove_made_masks().unwrap();
        assert_eq!(there(), ["a.b.jpg.png own", "c.png own", "d.png own"]);
        own.iter().for_each(|path| std::fs::remove_file(path).unwrap());
        copy_masks("new");
        workspace.remove_made_masks().unwrap();
        assert!(!workspace.masks.exists());
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
