//! Folders that one program writes to at a time.

use std::fs::{File, OpenOptions, TryLockError};
use std::io::{Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use dpges_core::Error;
use dpges_core::scene::atomic::make_folder;
use serde_json::Value;

use crate::dataset::source::Source;

/// Keeps the lock of a folder, and names of files that were written to it.
const NAME: &str = ".dpges-lock";

#[derive(Debug, thiserror::Error)]
pub enum HoldError {
    #[error("another dpges is writing to {}: wait until it has ended, or name another folder", .path.display())]
    Held { path: PathBuf },
    #[error(
        "{} is there already, and is not of dpges, which would replace it: name another folder, or move it away", .path.display()
    )]
    Foreign { path: PathBuf },
    #[error("{} is a file of the dataset, which would be replaced: name another file", .path.display())]
    OfDataset { path: PathBuf },
    #[error(transparent)]
    File(#[from] Error),
}

/// A folder that no other program gets before this and its copies are dropped.
#[derive(Clone, Debug)]
pub struct Hold(Arc<Held>);

#[derive(Debug)]
struct Held {
    folder: PathBuf,
    file: File,
    /// The folder and those above it that were not there before, the deepest first.
    made: Vec<PathBuf>,
}

impl Drop for Held {
    /// Leaves nothing where nothing was written.
    fn drop(&mut self) {
        if self.file.metadata().is_ok_and(|file| file.len() == 0) {
            // what remains does no harm
            let _ = std::fs::remove_file(self.folder.join(NAME));
            let _ = self.made.iter().try_for_each(std::fs::remove_dir);
        }
    }
}

impl Hold {
    /// Makes the folder at `path`, whose files this program is going to write.
    ///
    /// # Errors
    /// [`HoldError::Held`] if another one does, [`HoldError::File`] if it cannot be made or written.
    pub fn of_folder(path: &Path) -> Result<Self, HoldError> {
        let made = path.ancestors().take_while(|above| !above.as_os_str().is_empty() && !above.exists());
        let made = made.map(Path::to_owned).collect();
        make_folder(path)?;
        let (folder, lock) = (path.to_owned(), path.join(NAME));
        let opened = OpenOptions::new().read(true).write(true).create(true).truncate(false).open(&lock);
        let file = opened.map_err(failed("cannot write to", path))?;
        match file.try_lock() {
            Err(TryLockError::WouldBlock) => Err(HoldError::Held { path: folder }),
            Err(TryLockError::Error(error)) if error.kind() != std::io::ErrorKind::Unsupported => {
                Err(failed("cannot lock", &lock)(error).into())
            }
            _ => Ok(Self(Arc::new(Held { folder, file, made }))),
        }
    }

    pub fn folder(&self) -> &Path {
        &self.0.folder
    }

    /// Says before they are written which files are going to be.
    ///
    /// # Errors
    /// [`HoldError::Foreign`] if one of them is there, and was not written so: a photograph may be, [`HoldError::File`].
    pub fn add_files(&self, names: impl IntoIterator<Item = String>) -> Result<(), HoldError> {
        let (own, names) = (self.names()?, names.into_iter().collect::<Vec<String>>());
        let is_foreign = |name: &&String| self.0.folder.join(name).exists() && !own.lines().any(|own| own == **name);
        if let Some(name) = names.iter().find(is_foreign) {
            return Err(HoldError::Foreign { path: self.0.folder.join(name) });
        }
        let (mut file, names) = (&self.0.file, names.iter().map(|name| format!("{name}\n")).collect::<String>());
        let written = file.seek(SeekFrom::End(0)).and_then(|_| file.write_all(names.as_bytes()));
        Ok(written.map_err(failed("cannot write", &self.0.folder.join(NAME)))?)
    }

    /// Names of the files that were written before, a line each.
    fn names(&self) -> Result<String, HoldError> {
        let (mut file, mut text) = (&self.0.file, String::new());
        let read = file.rewind().and_then(|()| file.read_to_string(&mut text));
        read.map_err(failed("cannot read", &self.0.folder.join(NAME)))?;
        Ok(text)
    }

    /// Says which files have been written. Those of an earlier time that are not among them are removed, as frames of a
    /// longer path are, and nothing else.
    ///
    /// # Errors
    /// [`HoldError::File`].
    pub fn replace_files(&self, names: &[String]) -> Result<(), HoldError> {
        let (mut file, text, lock) = (&self.0.file, self.names()?, self.0.folder.join(NAME));
        for old in text.lines().filter(|old| !names.iter().any(|name| name == old) && !old.contains(['/', '\\'])) {
            let file = self.0.folder.join(old);
            if file.exists() {
                std::fs::remove_file(&file).map_err(failed("cannot remove", &file))?;
            }
        }
        let mut write = || {
            file.set_len(0)?;
            file.rewind()?;
            file.write_all((names.join("\n") + "\n").as_bytes())
        };
        Ok(write().map_err(failed("cannot write", &lock))?)
    }
}

/// Checks before the work that the file at `path` can be written after it. A folder that is not there is not made.
///
/// # Errors
/// [`Error::Io`].
pub fn check_file(path: &Path) -> Result<(), Error> {
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    if path.is_dir() {
        return Err(failed("cannot write", path)(std::io::ErrorKind::IsADirectory.into()));
    }
    if !folder.is_dir() {
        let absent = std::io::Error::other("it does not exist; make it, or name another");
        return Err(failed("cannot write to the folder", folder)(absent));
    }
    tempfile::Builder::new().prefix(".dpges-").tempfile_in(folder).map(drop).map_err(failed("cannot write", path))
}

/// Checks before the work that a report may be written to `path`: a file in the folder of the dataset is not replaced unless it is a
/// report itself, a JSON object without frames, as files of cameras have them.
///
/// # Errors
/// [`HoldError::OfDataset`].
pub fn check_report(path: &Path, source: &Source) -> Result<(), HoldError> {
    let Source::Folder(folder) = source else { return Ok(()) };
    let is_within =
        path.canonicalize().is_ok_and(|path| folder.canonicalize().is_ok_and(|root| path.starts_with(root)));
    let content = || serde_json::from_slice::<Value>(&std::fs::read(path).unwrap_or_default());
    let is_report = || content().is_ok_and(|content| content.is_object() && content.get("frames").is_none());
    if is_within && !is_report() { Err(HoldError::OfDataset { path: path.to_owned() }) } else { Ok(()) }
}

fn failed<'a>(action: &'static str, path: &'a Path) -> impl FnOnce(std::io::Error) -> Error + 'a {
    move |source| Error::Io { action, path: path.to_owned(), source }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_program_at_a_time_writes_to_a_folder() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("new/pictures");
        let first = Hold::of_folder(&path).unwrap();
        let again = Hold::of_folder(&path).unwrap_err();
        assert!(matches!(&again, HoldError::Held { .. }) && again.to_string().contains("pictures"), "{again}");
        drop(first);
        assert!(!folder.path().join("new").exists(), "nothing was written");
        Hold::of_folder(&path).unwrap();
        let file = folder.path().join("file");
        std::fs::write(&file, "").unwrap();
        assert!(Hold::of_folder(&file.join("below")).unwrap_err().to_string().contains("below"));
        let absent = check_file(&folder.path().join("absent/x.ply")).unwrap_err().to_string();
        assert!(absent.contains("absent: it does not exist") && !absent.contains("x.ply"), "{absent}");
        check_file(&folder.path().join("x.ply")).unwrap();
    }

    #[test]
    fn files_of_an_earlier_time_go_and_others_stay() {
        let folder = tempfile::tempdir().unwrap();
        let has = |name: &str| folder.path().join(name).exists();
        let write = |names: &[&str]| {
            let names: Vec<String> = names.iter().map(|&name| name.to_owned()).collect();
            Hold::of_folder(folder.path()).unwrap().replace_files(&names).unwrap();
            names.iter().for_each(|name| std::fs::write(folder.path().join(name), "").unwrap());
        };
        std::fs::write(folder.path().join("00009.png"), "").unwrap();
        write(&["00000.png", "00001.png", "00002.png"]);
        write(&["00000.png", "00001.png"]);
        assert!(has("00001.png") && !has("00002.png") && has("00009.png"));
    }

    #[test]
    fn files_of_others_are_not_replaced() {
        let folder = tempfile::tempdir().unwrap();
        let names = || ["a.png".to_owned(), "b.png".to_owned()];
        let add = || Hold::of_folder(folder.path()).unwrap().add_files(names());
        add().unwrap();
        names().iter().for_each(|name| std::fs::write(folder.path().join(name), "").unwrap());
        add().unwrap();
        std::fs::write(folder.path().join("c.png"), "a photograph").unwrap();
        let error = Hold::of_folder(folder.path()).unwrap().add_files(["c.png".to_owned()]).unwrap_err();
        assert!(error.to_string().contains("c.png is there already"), "{error}");
        let source = Source::Folder(folder.path().to_owned());
        let check = |text: &str, source: &Source| {
            let file = folder.path().join("transforms.json");
            std::fs::write(&file, text).unwrap();
            check_report(&file, source)
        };
        for cameras in ["{\"frames\": []}", "[1]", "<xml>"] {
            assert!(matches!(check(cameras, &source), Err(HoldError::OfDataset { .. })), "{cameras}");
        }
        check("{\"mean\": {}}", &source).unwrap();
        check("[1]", &Source::Builtin).unwrap();
        check_report(&folder.path().join("new.json"), &source).unwrap();
    }
}
