//! A program at work: its output goes to a log, and is read there while it grows. So the log is complete even if this
//! process ends first.

use std::ffi::OsString;
use std::fs::{File, OpenOptions};
use std::io::{Read, Seek, SeekFrom, Write};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use super::error::{SfmError, io};
use super::step::Step;

/// Between two looks at the log: of a program that has just begun, and at most.
const FIRST_PAUSE: Duration = Duration::from_millis(5);
const LONGEST_PAUSE: Duration = Duration::from_millis(250);
/// Lines of the log that an error shows.
const TAIL_LINES: usize = 12;

pub(super) struct Job<'a> {
    pub step: Step,
    pub program: &'a Path,
    pub arguments: &'a [OsString],
    /// File that the output is appended to, after the command line.
    pub log: &'a Path,
}

/// Runs a program to its end. `line` hears each line of its output.
///
/// # Errors
/// [`SfmError::Start`], [`SfmError::Failed`] with the end of the log, [`SfmError::File`] for the log.
pub(super) fn run(job: &Job, line: &mut dyn FnMut(&str)) -> Result<(), SfmError> {
    let mut log = OpenOptions::new().append(true).create(true).open(job.log).map_err(io("cannot write", job.log))?;
    writeln!(log, "$ {}", command_line(job)).map_err(io("cannot write", job.log))?;
    let mut growing = Growing::at_end(job.log)?;
    let start = growing.position;
    let output = || log.try_clone().map(Stdio::from).map_err(io("cannot write", job.log));
    let child = Command::new(job.program)
        .args(job.arguments)
        .stdin(Stdio::null())
        .stdout(output()?)
        .stderr(output()?)
        .spawn()
        .map_err(|source| SfmError::Start { program: job.program.to_owned(), source })?;
    let mut child = EndsWithThis(child);
    let mut pause = FIRST_PAUSE;
    let status = loop {
        let status =
            child.0.try_wait().map_err(|source| SfmError::Start { program: job.program.to_owned(), source })?;
        growing.lines(line)?;
        if let Some(status) = status {
            break status;
        }
        std::thread::sleep(pause);
        pause = (2 * pause).min(LONGEST_PAUSE);
    };
    if status.success() {
        return Ok(());
    }
    let tail = tail(job.log, start)?;
    let (step, program, log) = (job.step, job.program.to_owned(), job.log.to_owned());
    Err(SfmError::Failed { step, program, status: status.to_string(), log, tail })
}

fn command_line(job: &Job) -> String {
    let words = job.arguments.iter().map(|word| word.to_string_lossy().into_owned());
    std::iter::once(job.program.display().to_string()).chain(words).collect::<Vec<_>>().join(" ")
}

/// A process that does not outlive this value.
struct EndsWithThis(Child);

impl Drop for EndsWithThis {
    fn drop(&mut self) {
        // It has ended already, unless this process is unwinding or the log cannot be read.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// A file that another process appends to.
struct Growing<'a> {
    path: &'a Path,
    file: File,
    position: u64,
    /// The beginning of a line whose end has not been written yet.
    unfinished: Vec<u8>,
}

impl<'a> Growing<'a> {
    fn at_end(path: &'a Path) -> Result<Self, SfmError> {
        let mut file = File::open(path).map_err(io("cannot read", path))?;
        let position = file.seek(SeekFrom::End(0)).map_err(io("cannot read", path))?;
        Ok(Self { path, file, position, unfinished: Vec::new() })
    }

    /// Hands over the lines that have been completed. Carriage returns end lines too: they begin a line anew.
    fn lines(&mut self, line: &mut dyn FnMut(&str)) -> Result<(), SfmError> {
        let count = self.file.read_to_end(&mut self.unfinished).map_err(io("cannot read", self.path))?;
        self.position += count as u64;
        while let Some(end) = self.unfinished.iter().position(|byte| matches!(byte, b'\n' | b'\r')) {
            let complete: Vec<u8> = self.unfinished.drain(..=end).collect();
            line(String::from_utf8_lossy(&complete).trim_end());
        }
        Ok(())
    }
}

/// The last lines of the file from byte `start` on that say anything.
fn tail(path: &Path, start: u64) -> Result<String, SfmError> {
    let bytes = std::fs::read(path).map_err(io("cannot read", path))?;
    let text = String::from_utf8_lossy(bytes.get(start as usize..).unwrap_or_default()).into_owned();
    let lines: Vec<&str> = text.lines().map(str::trim_end).filter(|line| !line.is_empty()).collect();
    let last = &lines[lines.len().saturating_sub(TAIL_LINES)..];
    Ok(last.iter().map(|line| format!("    {line}\n")).collect::<String>().trim_end().to_owned())
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;

    fn run_script(folder: &Path, script: &str) -> (Result<(), SfmError>, Vec<String>) {
        let arguments: Vec<OsString> = ["-c", script].map(OsString::from).to_vec();
        let job = Job {
            step: Step::Mapping,
            program: Path::new("/bin/sh"),
            arguments: &arguments,
            log: &folder.join("a.log"),
        };
        let mut heard = Vec::new();
        let result = run(&job, &mut |line| heard.push(line.to_owned()));
        (result, heard)
    }

    #[test]
    fn both_outputs_are_heard_by_the_line_and_kept() {
        let folder = tempfile::tempdir().unwrap();
        let (result, heard) = run_script(folder.path(), "echo one; echo two >&2; printf 'three\\rfour'");
        result.unwrap();
        assert_eq!(heard, ["one", "two", "three"], "the fourth line has no end");
        let (_, heard) = run_script(folder.path(), "echo five");
        assert_eq!(heard, ["five"], "what was in the log before is not heard again");
        let log = std::fs::read_to_string(folder.path().join("a.log")).unwrap();
        assert!(
            log.starts_with("$ /bin/sh -c echo one") && log.contains("four$ /bin/sh") && log.ends_with("five\n"),
            "{log}"
        );
    }

    #[test]
    fn a_failure_names_the_log_and_shows_its_end() {
        let folder = tempfile::tempdir().unwrap();
        run_script(folder.path(), "echo before").0.unwrap();
        let script =
            "for i in 1 2 3 4 5 6 7 8 9 10 11 12 13 14; do echo line $i; done; echo; echo no memory >&2; exit 3";
        let message = run_script(folder.path(), script).0.unwrap_err().to_string();
        for part in ["mapping", "/bin/sh", "exit status: 3", "a.log", "    line 14\n    no memory\n", "goes on"] {
            assert!(message.contains(part), "{part}: {message}");
        }
        assert!(!message.contains("line 3\n") && !message.contains("before"), "{message}");
    }

    #[test]
    fn what_cannot_be_started_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let program = folder.path().join("absent");
        let job = Job { step: Step::Features, program: &program, arguments: &[], log: &folder.path().join("a.log") };
        let message = run(&job, &mut |_| {}).unwrap_err().to_string();
        assert!(message.contains("absent") && message.contains("cannot be started"), "{message}");
    }
}
