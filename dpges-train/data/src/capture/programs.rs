//! The programs of the user's machine: where they are, and how they run.

use std::collections::VecDeque;
use std::ffi::OsStr;
use std::fs::OpenOptions;
use std::io::{BufRead, BufReader, Write};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use super::error::{SfmError, io};
use super::step::Step;

const ENDINGS: &[&str] = if cfg!(windows) { &[".exe", ".bat"] } else { &[""] };
/// Lines of the output that an error shows.
const TAIL_LINES: usize = 12;

/// The folders in which programs are looked for, in this order.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Programs(pub Vec<PathBuf>);

impl Programs {
    /// In the folders of the environment variable `PATH`.
    pub fn of_environment() -> Self {
        let path = std::env::var_os("PATH").unwrap_or_default();
        Self(std::env::split_paths(&path).collect())
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
        self.find(name).ok_or_else(|| {
            let remedy = format!(
                "install it (Debian, Ubuntu: `apt-get install {name}`; macOS: `brew install {name}`; others: {page}) so that \
                 `{name}` is in the search path"
            );
            SfmError::MissingProgram { program, purpose, remedy }
        })
    }

    pub(super) fn find(&self, name: &str) -> Option<PathBuf> {
        let names = ENDINGS.iter().map(|end| format!("{name}{end}"));
        let mut paths = names.flat_map(|name| self.0.iter().map(move |folder| folder.join(&name)));
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

/// The output of a program, standard output and error.
pub(super) fn said(command: &mut Command) -> Result<String, SfmError> {
    let output = command.stdin(Stdio::null()).output();
    let output = output.map_err(|source| SfmError::Start { program: command.get_program().into(), source })?;
    Ok(String::from_utf8_lossy(&[output.stdout, output.stderr].concat()).into_owned())
}

/// Runs a program to its end. Its command line and its output, on either stream, are appended to file `path`; `line` hears
/// the output line by line.
///
/// # Errors
/// [`SfmError::Start`], [`SfmError::Failed`] with the end of the output, [`SfmError::File`] for the log.
pub(super) fn run(step: Step, mut command: Command, path: &Path, line: &mut dyn FnMut(&str)) -> Result<(), SfmError> {
    let program = PathBuf::from(command.get_program());
    let failed = |source| SfmError::Start { program: program.clone(), source };
    let mut log = OpenOptions::new().append(true).create(true).open(path).map_err(io("cannot write", path))?;
    let words: Vec<_> = command.get_args().map(OsStr::to_string_lossy).collect();
    writeln!(log, "$ {} {}", program.display(), words.join(" ")).map_err(io("cannot write", path))?;
    let (output, input) = std::io::pipe().map_err(failed)?;
    command.stdin(Stdio::null()).stdout(input.try_clone().map_err(failed)?).stderr(input);
    let child = command.spawn().map_err(failed);
    // the pipe ends with the program
    drop(command);
    let mut child = child?;
    let (mut output, mut bytes, mut tail) = (BufReader::new(output), Vec::new(), VecDeque::new());
    while output.read_until(b'\n', &mut bytes).map_err(failed)? > 0 {
        log.write_all(&bytes).map_err(io("cannot write", path))?;
        let text = String::from_utf8_lossy(&bytes);
        // carriage returns begin a line anew
        for text in text.split(['\n', '\r']).map(str::trim_end).filter(|text| !text.is_empty()) {
            line(text);
            tail.push_back(format!("    {text}"));
        }
        bytes.clear();
        tail.drain(..tail.len().saturating_sub(TAIL_LINES));
    }
    let status = child.wait().map_err(failed)?;
    if status.success() {
        return Ok(());
    }
    let (tail, status) = (tail.make_contiguous().join("\n"), status.to_string());
    Err(SfmError::Failed { step, program, status, log: path.to_owned(), tail })
}

#[cfg(all(test, unix))]
mod tests {
    use std::os::unix::fs::PermissionsExt;

    use super::*;
    use crate::fixtures::assert_says;

    #[test]
    fn the_first_folder_with_a_program_of_the_name_wins() {
        let folders = [(); 3].map(|()| tempfile::tempdir().unwrap());
        let paths: Vec<PathBuf> = folders.iter().map(|folder| folder.path().to_owned()).collect();
        let programs = Programs(paths.clone());
        for (path, mode) in paths.iter().zip([0o644, 0o755, 0o755]) {
            std::fs::write(path.join("colmap"), "").unwrap();
            std::fs::set_permissions(path.join("colmap"), PermissionsExt::from_mode(mode)).unwrap();
        }
        assert_eq!(programs.colmap().unwrap(), paths[1].join("colmap"), "the first is no program");
    }

    fn run_script(folder: &Path, script: &str) -> (Result<(), SfmError>, Vec<String>) {
        let mut command = Command::new("/bin/sh");
        command.args(["-c", script]);
        let mut heard = Vec::new();
        let result = run(Step::Mapping, command, &folder.join("a.log"), &mut |line| heard.push(line.to_owned()));
        (result, heard)
    }

    #[test]
    fn both_outputs_are_heard_by_the_line_and_kept() {
        let folder = tempfile::tempdir().unwrap();
        let (result, heard) = run_script(folder.path(), "echo one; echo two >&2; printf 'three\\rfour'");
        result.unwrap();
        assert_eq!(heard, ["one", "two", "three", "four"]);
        let (_, heard) = run_script(folder.path(), "echo five");
        assert_eq!(heard, ["five"]);
        let log = std::fs::read_to_string(folder.path().join("a.log")).unwrap();
        let parts = log.starts_with("$ /bin/sh -c echo one") && log.contains("four$ /bin/sh");
        assert!(parts && log.ends_with("five\n"), "{log}");
    }

    #[test]
    fn a_failure_names_the_log_and_shows_its_end() {
        let folder = tempfile::tempdir().unwrap();
        run_script(folder.path(), "echo before").0.unwrap();
        let script =
            "for i in 1 2 3 4 5 6 7 8 9 10 11 12 13 14; do echo line $i; done; echo; echo no memory >&2; exit 3";
        let message = run_script(folder.path(), script).0.unwrap_err().to_string();
        let parts = ["mapping", "/bin/sh", "exit status: 3", "a.log", "    line 14\n    no memory\n", "goes on"];
        assert_says(&message, &parts);
        assert!(!message.contains("line 3\n") && !message.contains("before"), "{message}");
        let absent = Command::new(folder.path().join("absent"));
        let error = run(Step::Features, absent, &folder.path().join("a.log"), &mut |_| {}).unwrap_err();
        assert_says(error, &["absent", "cannot be started"]);
    }
}
