//! Faults of the machine: a run that is killed at any moment, or finds the disk full, loses nothing.
//!
//! `DPGES_KILLS` sets how often a run is killed (5 unless set).
#![cfg(unix)]

use std::path::Path;
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

use tempfile::TempDir;

/// Two stages in a second, with a checkpoint after every other step, so that files are written most of the time.
const RUN: [&str; 9] = [
    "--device=cpu",
    "--max-resolution=24",
    "--steps=40",
    "--set=init.max_points=300",
    "--set=stages.surfels=0.4",
    "--set=train.evaluate_every=10",
    "--set=train.checkpoint_every=2",
    "--budget=900",
    "--seed=5",
];

fn command(folder: &Path, args: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_dpges"));
    command.current_dir(folder).args(args).stdout(Stdio::null()).stderr(Stdio::piped());
    command
}

fn begin(out: &str) -> Vec<&str> {
    [&["train", "--out", out], &RUN[..]].concat()
}

fn ok(folder: &Path, args: &[&str]) {
    let output = command(folder, args).output().unwrap();
    assert!(output.status.success(), "{args:?}: {}", String::from_utf8_lossy(&output.stderr));
}

fn bytes(path: &Path) -> Vec<u8> {
    std::fs::read(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

/// Lines of `metrics.jsonl` without what a clock says.
fn metrics(run: &Path) -> Vec<serde_json::Map<String, serde_json::Value>> {
    let text = String::from_utf8(bytes(&run.join("metrics.jsonl"))).unwrap();
    let parse = |line: &str| serde_json::from_str::<serde_json::Map<_, _>>(line).unwrap();
    let mut lines: Vec<_> = text.lines().map(parse).collect();
    lines.iter_mut().for_each(|line| line.retain(|key, _| !key.starts_with("seconds")));
    lines
}

/// The arguments with which the run in `folder` goes on, whatever is there.
fn go_on(folder: &Path) -> Vec<&'static str> {
    if folder.join("run/checkpoint.safetensors").is_file() {
        vec!["train", "--out", "run", "--resume"]
    } else {
        [begin("run"), vec!["--overwrite"]].concat()
    }
}

fn whole(folder: &Path) -> (Vec<u8>, Duration) {
    let start = Instant::now();
    ok(folder, &begin("whole"));
    (bytes(&folder.join("whole/scene.safetensors")), start.elapsed())
}

fn kill_after(mut child: Child, time: Duration) {
    std::thread::sleep(time);
    child.kill().unwrap();
    child.wait().unwrap();
}

#[test]
fn a_run_killed_at_random_moments_ends_with_the_same_bytes() {
    let folder: TempDir = tempfile::tempdir().unwrap();
    let at = folder.path();
    let (expected, length) = whole(at);
    let kills: u64 =
        std::env::var("DPGES_KILLS").map_or(5, |text| text.parse().expect("DPGES_KILLS is a whole number"));
    let mut ends = 0;
    for kill in 0..kills {
        // the golden ratio spreads the moments evenly, in an order that looks random
        let share = (kill as f64 * 0.618_034).fract();
        kill_after(command(at, &go_on(at)).spawn().unwrap(), length.mul_f64(0.05 + share));
        if at.join("run/eval.json").is_file() {
            assert!(bytes(&at.join("run/scene.safetensors")) == expected, "after {} kills", kill + 1);
            assert_eq!(metrics(&at.join("run")), metrics(&at.join("whole")));
            std::fs::remove_dir_all(at.join("run")).unwrap();
            ends += 1;
        }
    }
    ok(at, &go_on(at));
    assert!(bytes(&at.join("run/scene.safetensors")) == expected);
    assert_eq!(metrics(&at.join("run")), metrics(&at.join("whole")));
    println!("{kills} kills, {} runs to their ends, all with the same bytes", ends + 1);
}

/// Runs a command that cannot write files above `blocks` × 512 bytes, as on a full disk.
fn on_a_full_disk(folder: &Path, blocks: usize, args: &[&str]) -> Output {
    let script = format!("trap '' XFSZ; ulimit -f {blocks}; exec \"$0\" \"$@\"");
    Command::new("sh")
        .current_dir(folder)
        .args(["-c", &script, env!("CARGO_BIN_EXE_dpges")])
        .args(args)
        .output()
        .unwrap()
}

#[test]
fn a_full_disk_is_named_and_the_checkpoint_before_it_goes_on() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let (expected, length) = whole(at);
    // a run with a checkpoint, killed
    let mut share = 0.5;
    while !at.join("run/checkpoint.safetensors").is_file() {
        kill_after(command(at, &go_on(at)).spawn().unwrap(), length.mul_f64(share));
        share += 0.2;
    }
    let before = bytes(&at.join("run/checkpoint.safetensors"));
    let output = on_a_full_disk(at, 40, &["train", "--out", "run", "--resume"]);
    let message = String::from_utf8_lossy(&output.stderr).into_owned();
    if output.status.success() {
        // killed after its last checkpoint: nothing large was left to write
        assert!(at.join("run/eval.json").is_file());
    } else {
        assert_eq!(output.status.code(), Some(1), "{message}");
        assert!(message.contains(".safetensors") && message.contains("File too large"), "{message}");
        assert!(bytes(&at.join("run/checkpoint.safetensors")) == before, "the checkpoint is as it was");
        let left: Vec<_> = std::fs::read_dir(at.join("run")).unwrap().map(|entry| entry.unwrap().file_name()).collect();
        assert!(left.iter().all(|name| !name.to_string_lossy().contains("tmp")), "{left:?}");
    }
    ok(at, &["train", "--out", "run", "--resume"]);
    assert!(bytes(&at.join("run/scene.safetensors")) == expected);
}

#[test]
fn a_folder_that_cannot_be_written_is_named_before_the_first_step() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("file"), "").unwrap();
    for out in ["file/run", "/proc/dpges/run"] {
        let output = command(folder.path(), &begin(out)).output().unwrap();
        let message = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(1), "{message}");
        assert!(message.contains(out) && !message.contains("step 1/"), "{message}");
    }
}
