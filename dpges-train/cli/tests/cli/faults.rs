//! Faults of the machine: a run that is killed at any moment, or finds the disk full, loses nothing.
//!
//! `DPGES_KILLS` sets how often a run is killed (5 unless set).

use std::path::Path;
use std::process::{Child, Command};
use std::time::{Duration, Instant};

use super::{assert_contains, bytes, fails, folder, kill, metrics, ok, start};

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

fn begin(out: &str) -> Vec<&str> {
    [&["train", "--out", out], &RUN[..]].concat()
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
    (bytes(folder.join("whole/scene.safetensors")), start.elapsed())
}

fn kill_after(child: Child, time: Duration) {
    std::thread::sleep(time);
    kill(child);
}

#[test]
fn a_run_killed_at_random_moments_ends_with_the_same_bytes() {
    let at = &folder();
    let (expected, length) = whole(at);
    let kills: u64 =
        std::env::var("DPGES_KILLS").map_or(5, |text| text.parse().expect("DPGES_KILLS is a whole number"));
    let mut ends = 0;
    for kill in 0..kills {
        // the golden ratio spreads the moments evenly, in an order that looks random
        let share = (kill as f64 * 0.618_034).fract();
        kill_after(start(at, &go_on(at)), length.mul_f64(0.05 + share));
        if at.join("run/eval.json").is_file() {
            assert!(bytes(at.join("run/scene.safetensors")) == expected, "after {} kills", kill + 1);
            assert_eq!(metrics(&at.join("run")), metrics(&at.join("whole")));
            std::fs::remove_dir_all(at.join("run")).unwrap();
            ends += 1;
        }
    }
    ok(at, &go_on(at));
    assert!(bytes(at.join("run/scene.safetensors")) == expected);
    assert_eq!(metrics(&at.join("run")), metrics(&at.join("whole")));
    println!("{kills} kills, {} runs to their ends, all with the same bytes", ends + 1);
}

#[test]
fn a_full_disk_is_named_and_the_checkpoint_before_it_goes_on() {
    let at = &folder();
    let (expected, length) = whole(at);
    // a run with a checkpoint, killed
    let mut share = 0.5;
    while !at.join("run/checkpoint.safetensors").is_file() {
        kill_after(start(at, &go_on(at)), length.mul_f64(share));
        share += 0.2;
    }
    let before = bytes(at.join("run/checkpoint.safetensors"));
    // files have at most 40 × 512 bytes
    let script = "trap '' XFSZ; ulimit -f 40; exec \"$0\" train --out run --resume";
    let full = Command::new("sh").current_dir(at).args(["-c", script, env!("CARGO_BIN_EXE_dpges")]).output();
    let output = full.unwrap();
    let message = String::from_utf8_lossy(&output.stderr);
    if output.status.success() {
        // killed after its last checkpoint: nothing large was left to write
        assert!(at.join("run/eval.json").is_file());
    } else {
        assert_eq!(output.status.code(), Some(1), "{message}");
        assert_contains(&message, &[".safetensors", "File too large"]);
        assert!(bytes(at.join("run/checkpoint.safetensors")) == before, "the checkpoint is as it was");
        let left: Vec<_> = std::fs::read_dir(at.join("run")).unwrap().map(|entry| entry.unwrap().file_name()).collect();
        assert!(left.iter().all(|name| !name.to_string_lossy().contains("tmp")), "{left:?}");
    }
    ok(at, &["train", "--out", "run", "--resume"]);
    assert!(bytes(at.join("run/scene.safetensors")) == expected);
}

#[test]
fn a_folder_that_cannot_be_written_is_named_before_the_first_step() {
    let at = &folder();
    std::fs::write(at.join("file"), "").unwrap();
    for out in ["file/run", "/proc/dpges/run"] {
        let message = fails(at, 1, &begin(out));
        assert!(message.contains(out) && !message.contains("step 1/"), "{message}");
    }
}
