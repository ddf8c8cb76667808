//! The `dpges` binary as a process: exit codes, messages, files.

mod benchmark;
mod blocks;
mod clean;
mod devices;
#[cfg(unix)]
mod faults;
#[cfg(unix)]
mod interruption;
mod measures;
mod ray;
mod runs;
mod series;
#[cfg(unix)]
mod sfm;
mod stages;
mod trade;
mod usage;

use std::ops::Deref;
use std::path::{Path, PathBuf};
use std::process::Output;
use std::sync::OnceLock;

use assert_cmd::Command;
use serde_json::{Map, Value};
use tempfile::TempDir;

/// A run of a few seconds: every kind of event happens, the scene changes its size. On the CPU, where the same seed
/// gives the same bytes.
const TINY: [&str; 8] = [
    "--device=cpu",
    "--max-resolution=32",
    "--steps=60",
    "--set=init.max_points=400",
    "--set=train.evaluate_every=25",
    "--set=train.checkpoint_every=20",
    "--budget=1500",
    "--seed=3",
];

/// With a data folder of its own, in which no network for LPIPS is installed, and what is in `bin` in the search path.
fn dpges(folder: &Path, args: &[&str]) -> Output {
    command(folder).args(args).output().unwrap()
}

fn command(folder: &Path) -> Command {
    let path = format!("{}:{}", folder.join("bin").display(), std::env::var("PATH").unwrap_or_default());
    let mut command = Command::cargo_bin("dpges").unwrap();
    command.current_dir(folder).env("XDG_DATA_HOME", data_folder(folder)).env("PATH", path);
    command
}

fn data_folder(folder: &Path) -> PathBuf {
    folder.join("data-home")
}

fn ok(folder: &Path, args: &[&str]) -> String {
    both(folder, args).0
}

/// Standard error of a command that succeeds.
fn said(folder: &Path, args: &[&str]) -> String {
    both(folder, args).1
}

/// Standard output and error of a command that succeeds.
fn both(folder: &Path, args: &[&str]) -> (String, String) {
    let output = dpges(folder, args);
    let message = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(0), "{args:?}: {message}");
    (String::from_utf8(output.stdout).unwrap(), message)
}

/// The arguments of a command line.
fn words(line: &str) -> Vec<&str> {
    line.split(' ').collect()
}

/// The JSON that a command prints.
fn json_of(folder: &Path, args: &[&str]) -> Value {
    serde_json::from_str(&ok(folder, args)).unwrap()
}

#[track_caller]
fn assert_contains(text: &str, parts: &[&str]) {
    for part in parts {
        assert!(text.contains(part), "{part}: {text}");
    }
}

/// Standard error of a command that must end with `code`.
fn fails(folder: &Path, code: i32, args: &[&str]) -> String {
    let output = dpges(folder, args);
    let message = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(code), "{args:?}: {message}");
    message
}

fn train(folder: &Path, out: &str, more: &[&str]) -> String {
    ok(folder, &[&["train", "--out", out], &TINY[..], more].concat())
}

/// A copy of a run of [`TINY`], which is trained once for all tests.
fn trained(folder: &Path, out: &str) {
    static RUN: OnceLock<PathBuf> = OnceLock::new();
    let run = RUN.get_or_init(|| {
        let at = Path::new(env!("CARGO_TARGET_TMPDIR"));
        train(at, "tiny", &["--overwrite"]);
        at.join("tiny")
    });
    copy(run, &folder.join(out));
}

fn copy(from: &Path, to: &Path) {
    std::fs::create_dir_all(to).unwrap();
    for entry in std::fs::read_dir(from).unwrap().map(Result::unwrap) {
        let target = to.join(entry.file_name());
        if entry.path().is_dir() {
            copy(&entry.path(), &target);
        } else {
            std::fs::copy(entry.path(), target).unwrap();
        }
    }
}

fn bytes(path: impl AsRef<Path>) -> Vec<u8> {
    std::fs::read(path.as_ref()).unwrap_or_else(|error| panic!("{}: {error}", path.as_ref().display()))
}

/// Of a text file.
fn content(path: impl AsRef<Path>) -> String {
    String::from_utf8(bytes(path)).unwrap()
}

/// Without printing what is in them.
fn is_equal(a: impl AsRef<Path>, b: impl AsRef<Path>) -> bool {
    bytes(a) == bytes(b)
}

fn json(path: PathBuf) -> Value {
    serde_json::from_slice(&bytes(path)).unwrap()
}

/// Lines of `metrics.jsonl` without what a clock says.
fn metrics(run: &Path) -> Vec<Map<String, Value>> {
    let parse = |line: &str| serde_json::from_str::<Map<String, Value>>(line).unwrap();
    let mut lines: Vec<_> = content(run.join("metrics.jsonl")).lines().map(parse).collect();
    lines.iter_mut().for_each(|line| line.retain(|key, _| !key.starts_with("seconds")));
    lines
}

fn png_names(folder: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(folder).unwrap();
    let mut names: Vec<String> = entries
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .filter(|n| n.ends_with(".png"))
        .collect();
    names.sort();
    names
}

/// A folder that is removed with this.
struct Folder(TempDir);

impl Deref for Folder {
    type Target = Path;

    fn deref(&self) -> &Path {
        self.0.path()
    }
}

impl AsRef<Path> for Folder {
    fn as_ref(&self) -> &Path {
        self
    }
}

fn folder() -> Folder {
    Folder(tempfile::tempdir().unwrap())
}

/// Waits for `condition`, at most half a minute.
#[cfg(unix)]
fn wait_until(condition: impl Fn() -> bool) {
    let start = std::time::Instant::now();
    while !condition() {
        assert!(start.elapsed().as_secs() < 30, "the run did not get going");
        std::thread::sleep(std::time::Duration::from_millis(2));
    }
}

#[cfg(unix)]
fn start(folder: &Path, args: &[&str]) -> std::process::Child {
    std::process::Command::new(env!("CARGO_BIN_EXE_dpges"))
        .current_dir(folder)
        .env("XDG_DATA_HOME", data_folder(folder))
        .args(args)
        .stdout(std::process::Stdio::null())
        .stderr(std::process::Stdio::piped())
        .spawn()
        .unwrap()
}

/// Ends the process as a power cut does.
#[cfg(unix)]
fn kill(mut child: std::process::Child) {
    child.kill().unwrap();
    child.wait().unwrap();
}

#[cfg(unix)]
fn start_training(folder: &Path, out: &str, more: &[&str]) -> std::process::Child {
    start(folder, &[&["train", "--out", out], &TINY[..], more].concat())
}
