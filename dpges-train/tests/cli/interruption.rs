//! Runs that are interrupted.

use super::{folder, is_equal, metrics, ok, png_names, start_training, trained, wait_until};

#[test]
fn an_interrupted_run_resumes_to_the_same_scene() {
    let at = &folder();
    trained(at, "whole");

    let child = start_training(at, "stopped", &[]);
    wait_until(|| std::fs::metadata(at.join("stopped/metrics.jsonl")).is_ok_and(|file| file.len() > 0));
    let killed = std::process::Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap();
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
