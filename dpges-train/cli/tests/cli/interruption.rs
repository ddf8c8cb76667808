//! Runs that are interrupted.

use std::path::Path;
use std::process::Command;

use super::{
    TINY, data_folder, fails, folder, is_equal, kill, metrics, ok, png_names, start_training, trained, wait_until,
};

fn wait_for_metrics(run: &Path) {
    wait_until(|| std::fs::metadata(run.join("metrics.jsonl")).is_ok_and(|file| file.len() > 0));
}

#[test]
fn an_interrupted_run_resumes_to_the_same_scene() {
    let at = &folder();
    trained(at, "whole");

    let child = start_training(at, "stopped", &[]);
    wait_for_metrics(&at.join("stopped"));
    let killed = Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap();
    assert!(killed.success());
    let output = child.wait_with_output().unwrap();
    let message = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(1), "{message}");
    assert!(message.contains("interrupted") && message.contains("train --out stopped --resume"), "{message}");
    ok(at, &["info", "stopped"]);
    ok(at, &["train", "--out", "stopped", "--resume"]);

    assert!(is_equal(at.join("whole/scene.safetensors"), at.join("stopped/scene.safetensors")));
    assert_eq!(metrics(&at.join("whole")), metrics(&at.join("stopped")));
    let [whole, stopped] = ["whole", "stopped"].map(|run| png_names(&at.join(run).join("pictures")));
    assert_eq!(whole, stopped);
}

#[test]
fn one_program_at_a_time_writes_to_a_run() {
    let at = &folder();
    let child = start_training(at, "run", &["--steps=100000", "--set=train.checkpoint_every=1"]);
    wait_for_metrics(&at.join("run"));
    wait_until(|| at.join("run/checkpoint.safetensors").is_file());
    for other in [
        &["train", "--out", "run", "--resume"][..],
        &[&["train", "--out", "run", "--overwrite"], &TINY[..]].concat(),
        &["eval", "run", "--json", "run/eval.json"],
        &["render", "run", "--out", "run"],
    ] {
        let message = fails(at, 1, other);
        assert!(message.contains("another dpges is writing to run"), "{other:?}: {message}");
    }
    kill(child);
    assert!(at.join("run/metrics.jsonl").is_file());
}

#[test]
fn a_run_that_is_started_with_nohup_outlives_its_terminal() {
    let at = &folder();
    let arguments = [&["train", "--out", "run"], &TINY[..]].concat();
    let script = "trap '' HUP; exec \"$0\" \"$@\"";
    let mut child = Command::new("sh")
        .current_dir(at)
        .env("XDG_DATA_HOME", data_folder(at))
        .args(["-c", script, env!("CARGO_BIN_EXE_dpges")])
        .args(arguments)
        .stdout(std::process::Stdio::null())
        .spawn()
        .unwrap();
    wait_for_metrics(&at.join("run"));
    assert!(Command::new("kill").args(["-HUP", &child.id().to_string()]).status().unwrap().success());
    assert!(child.wait().unwrap().success() && at.join("run/eval.json").is_file());
}
