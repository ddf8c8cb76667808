//! Where programs are.

use std::path::{Path, PathBuf};

use super::error::SfmError;

/// Ends of the file names of programs.
const ENDINGS: &[&str] = if cfg!(windows) { &[".exe", ".bat"] } else { &[""] };

/// The folders in which programs are looked for.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Programs {
    folders: Vec<PathBuf>,
}

impl Programs {
    /// In the folders of the environment variable `PATH`.
    pub fn of_environment() -> Self {
        let path = std::env::var_os("PATH").unwrap_or_default();
        Self { folders: std::env::split_paths(&path).collect() }
    }

    /// In `folders`, in this order.
    pub fn within(folders: Vec<PathBuf>) -> Self {
        Self { folders }
    }

    /// # Errors
    /// [`SfmError::MissingProgram`].
    pub(super) fn colmap(&self) -> Result<PathBuf, SfmError> {
        let page = "https://colmap.github.io/install.html";
        self.required("colmap", "COLMAP", "which finds the cameras of photographs", page)
    }

    /// # Errors
    /// [`SfmError::MissingProgram`].
    pub(super) fn ffmpeg(&self) -> Result<PathBuf, SfmError> {
        let page = "https://ffmpeg.org/download.html";
        self.required("ffmpeg", "ffmpeg", "which takes photographs from a video", page)
    }

    fn required(
        &self,
        name: &str,
        program: &'static str,
        purpose: &'static str,
        page: &str,
    ) -> Result<PathBuf, SfmError> {
        let remedy = || {
            format!(
                "install it (Debian, Ubuntu: `apt-get install {name}`; macOS: `brew install {name}`; others: {page}) so that \
                 `{name}` is in the search path"
            )
        };
        self.find(name).ok_or_else(|| SfmError::MissingProgram { program, purpose, remedy: remedy() })
    }

    pub(super) fn find(&self, name: &str) -> Option<PathBuf> {
        let names = ENDINGS.iter().map(|end| format!("{name}{end}"));
        let mut paths = names.flat_map(|name| self.folders.iter().map(move |folder| folder.join(&name)));
        paths.find(|path| is_program(path))
    }
}

#[cfg(unix)]
fn is_program(path: &Path) -> bool {
    use std::os::unix::fs::PermissionsExt;
    path.metadata().is_ok_and(|metadata| metadata.is_file() && metadata.permissions().mode() & 0o111 != 0)
}

#[cfg(not(unix))]
fn is_program(path: &Path) -> bool {
    path.is_file()
}

#[cfg(all(test, unix))]
mod tests {
    use std::os::unix::fs::PermissionsExt;

    use super::*;

    #[test]
    fn the_first_folder_with_a_program_of_the_name_wins() {
        let folders = [(); 3].map(|()| tempfile::tempdir().unwrap());
        let paths: Vec<PathBuf> = folders.iter().map(|folder| folder.path().to_owned()).collect();
        let programs = Programs::within(paths.clone());
        for error in [programs.colmap().unwrap_err(), programs.ffmpeg().unwrap_err()] {
            let message = error.to_string();
            assert!(message.contains("is not installed") && message.contains("apt-get install"), "{message}");
        }
        for path in &paths {
            std::fs::write(path.join("colmap"), "").unwrap();
        }
        for path in &paths[1..] {
            std::fs::set_permissions(path.join("colmap"), PermissionsExt::from_mode(0o755)).unwrap();
        }
        assert_eq!(programs.colmap().unwrap(), paths[1].join("colmap"), "the first is no program");
    }
}
