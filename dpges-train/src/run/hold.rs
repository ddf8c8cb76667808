//! Folders that one program writes to at a time.

use std::fs::{File, OpenOptions, TryLockError};
use std::io::{Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use dpges_core::Error;
use dpges_core::scene::atomic::make_folder;

/// Keeps the lock of a folder, and names of files that were written to it.
const NAME: &str = ".dpges-lock";

#[derive(Debug, thiserror::Error)]
pub enum HoldError {
    #[error("another dpges is writing to {}: wait until it has ended, or name another folder", .path.display())]
    Held { path: PathBuf },
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
    /// [`HoldError::File`].
    pub fn add_files(&self, names: impl Iterator<Item = String>) -> Result<(), HoldError> {
        let (mut file, names) = (&self.0.file, names.map(|name| name + "\n").collect::<String>());
        let written = file.seek(SeekFrom::End(0)).and_then(|_| file.write_all(names.as_bytes()));
        Ok(written.map_err(failed("cannot write", &self.0.folder.join(NAME)))?)
    }

    /// Says which files have been written. Those of an earlier time that are not among them are removed, as frames of a
    /// longer path are, and nothing else.
    ///
    /// # Errors
    /// [`HoldError::File`].
    pub fn replace_files(&self, names: &[String]) -> Result<(), HoldError> {
        let (mut file, mut text) = (&self.0.file, String::new());
        let lock = self.0.folder.join(NAME);
        file.rewind().and_then(|()| file.read_to_string(&mut text)).map_err(failed("cannot read", &lock))?;
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
    tempfile::Builder::new().prefix(".dpges-").tempfile_in(folder).map(drop).map_err(failed("cannot write", path))
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
        assert!(check_file(&folder.path().join("absent/x.ply")).unwrap_err().to_string().contains("x.ply"));
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
}
