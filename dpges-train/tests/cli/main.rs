//! The `dpges` binary as a process: exit codes, messages, files.

mod benchmark;
mod blocks;
mod devices;
#[cfg(unix)]
mod interruption;
mod measures;
mod runs;
mod series;
mod stages;
mod trade;
mod usage;

use std::path::{Path, PathBuf};
use std::process::Output;

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

/// With a data folder of its own, in which no network for LPIPS is installed.
fn dpges(folder: &Path, args: &[&str]) -> Output {
    let mut command = Command::cargo_bin("dpges").unwrap();
    command.current_dir(folder).env("XDG_DATA_HOME", data_folder(folder)).args(args).output().unwrap()
}

fn data_folder(folder: &Path) -> PathBuf {
    folder.join("data-home")
}

fn ok(folder: &Path, args: &[&str]) -> String {
    let output = dpges(folder, args);
    assert_eq!(output.status.code(), Some(0), "{args:?}: {}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap()
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

fn bytes(path: impl AsRef<Path>) -> Vec<u8> {
    std::fs::read(path.as_ref()).unwrap_or_else(|error| panic!("{}: {error}", path.as_ref().display()))
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
    let text = String::from_utf8(bytes(run.join("metrics.jsonl"))).unwrap();
    let lines = text.lines().map(|line| serde_json::from_str::<Map<String, Value>>(line).unwrap());
    lines
        .map(|mut line| {
            line.retain(|key, _| !key.starts_with("seconds"));
            line
        })
        .collect()
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

fn folder() -> TempDir {
    tempfile::tempdir().unwrap()
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

#[cfg(unix)]
fn start_training(folder: &Path, out: &str, more: &[&str]) -> std::process::Child {
    start(folder, &[&["train", "--out", out], &TINY[..], more].concat())
}
