//! A program at work: its output goes to a log, and is heard by the line.

use std::collections::VecDeque;
use std::ffi::OsString;
use std::fs::OpenOptions;
use std::io::{BufRead, BufReader, Write};
use std::path::Path;
use std::process::{Command, Stdio};

use super::error::{SfmError, io};
use super::step::Step;

/// Lines of the output that an error shows.
const TAIL_LINES: usize = 12;

pub(super) struct Job<'a> {
    pub step: Step,
    pub program: &'a Path,
    pub arguments: &'a [OsString],
    /// File that the output is appended to, after the command line.
    pub log: &'a Path,
}

/// Runs a program to its end. `line` hears each line of its output, on either stream.
///
/// # Errors
/// [`SfmError::Start`], [`SfmError::Failed`] with the end of the output, [`SfmError::File`] for the log.
pub(super) fn run(job: &Job, line: &mut dyn FnMut(&str)) -> Result<(), SfmError> {
    let Job { step, program, arguments, log: path } = *job;
    let failed = |source| SfmError::Start { program: program.to_owned(), source };
    let mut log = OpenOptions::new().append(true).create(true).open(path).map_err(io("cannot write", path))?;
    let words: Vec<_> = arguments.iter().map(|word| word.to_string_lossy()).collect();
    writeln!(log, "$ {} {}", program.display(), words.join(" ")).map_err(io("cannot write", path))?;
    let (output, input) = std::io::pipe().map_err(failed)?;
    let mut command = Command::new(program);
    command.args(arguments).stdin(Stdio::null()).stdout(input.try_clone().map_err(failed)?).stderr(input);
    let child = command.spawn().map_err(failed);
    // the pipe ends with the program
    drop(command);
    let mut child = child?;
    let (mut output, mut bytes, mut tail) = (BufReader::new(output), Vec::new(), VecDeque::new());
    while output.read_until(b'\n', &mut bytes).map_err(failed)? > 0 {
        log.write_all(&bytes).map_err(io("cannot write", path))?;
        // carriage returns begin a line anew
        for text in
            String::from_utf8_lossy(&bytes).split(['\n', '\r']).map(str::trim_end).filter(|text| !text.is_empty())
        {
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
    Err(SfmError::Failed { step, program: program.to_owned(), status, log: path.to_owned(), tail })
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;

    fn run_script(folder: &Path, script: &str) -> (Result<(), SfmError>, Vec<String>) {
        let (program, log) = (Path::new("/bin/sh"), &folder.join("a.log"));
        let job = Job { step: Step::Mapping, program, arguments: &["-c", script].map(OsString::from), log };
        let mut heard = Vec::new();
        let result = run(&job, &mut |line| heard.push(line.to_owned()));
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
        for part in ["mapping", "/bin/sh", "exit status: 3", "a.log", "    line 14\n    no memory\n", "goes on"] {
            assert!(message.contains(part), "{part}: {message}");
        }
        assert!(!message.contains("line 3\n") && !message.contains("before"), "{message}");
        let (program, log) = (&folder.path().join("absent"), &folder.path().join("a.log"));
        let job = Job { step: Step::Features, program, arguments: &[], log };
        let message = run(&job, &mut |_| {}).unwrap_err().to_string();
        assert!(message.contains("absent") && message.contains("cannot be started"), "{message}");
    }
}
