//! Blocks of a plan on a cluster of Ray. It needs Python with Ray: `DPGES_PYTHON` names the interpreter; without Ray the test
//! says so and passes.

use std::path::Path;
use std::process::Command;
use std::time::SystemTime;

use serde_json::Value;

use super::{content, folder, ok};

fn modified(path: &Path) -> SystemTime {
    path.metadata().and_then(|file| file.modified()).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

#[test]
fn a_plan_outlives_a_node_and_no_block_is_trained_twice() {
    let python = std::env::var("DPGES_PYTHON").unwrap_or_else(|_| "python3".to_owned());
    let has_ray = Command::new(&python).args(["-c", "import ray.cluster_utils"]).output();
    if !has_ray.is_ok_and(|output| output.status.success()) {
        println!("{python} has no Ray: not tested");
        return;
    }
    let at = &folder();
    let plan = at.join("city");
    let here = Path::new(env!("CARGO_MANIFEST_DIR"));
    let small = ["--blocks=4", "--max-resolution=48", "--steps=300", "--budget=2500"];
    let often = ["--set=train.evaluate_every=0", "--set=train.checkpoint_every=20"];
    ok(at, &[&["blocks", "plan", "builtin", "--out=city"], &small[..], &often].concat());
    let tool = here.join("../tools/dpges_ray.py");
    let mut cluster = Command::new(&python);
    cluster.arg(here.join("tests/ray_cluster.py")).arg(&tool).arg(env!("CARGO_BIN_EXE_dpges")).arg(&plan);
    let started = cluster.output().unwrap();
    let messages = String::from_utf8_lossy(&started.stderr);
    let text = String::from_utf8_lossy(&started.stdout);
    let report: Value = serde_json::from_str(text.trim()).unwrap_or_else(|error| panic!("{error}: {text}{messages}"));
    println!("{report:#}");
    assert_eq!(report["code"], 0, "{messages}");

    let done = |step: &str| plan.join(step).join("done.json");
    assert!(["coarse", "block-0", "block-1", "block-2", "block-3", "merged"].iter().all(|step| done(step).is_file()));
    let log = |step: &str| content(plan.join(format!("{step}.log")));
    let starts = |step: &str| log(step).matches(": 180 steps").count();
    for block in report["before"].as_array().unwrap() {
        let block = block.as_str().unwrap();
        assert_eq!(starts(block), 1, "{block}: {}", log(block));
        assert!(!log(block).contains("resuming") && !log(block).contains("done already"), "{block}: {}", log(block));
    }
    let resumed = (0..4).filter(|block| log(&format!("block-{block}")).contains("resuming after step")).count();
    assert!(resumed >= 1, "the block of the node that was removed goes on where it was");

    // once more: nothing to do
    let before = modified(&done("block-2"));
    let again = Command::new(&python).arg(&tool).arg(&plan).arg("--gpus=0").output().unwrap();
    let said = String::from_utf8_lossy(&again.stdout);
    assert!(again.status.success() && said.matches("done before").count() == 6, "{said}");
    assert_eq!(modified(&done("block-2")), before);
    let nowhere = Command::new(&python).arg(&tool).arg("nowhere").output().unwrap();
    assert!(String::from_utf8_lossy(&nowhere.stderr).contains("dpges blocks plan DATASET --out nowhere"));
}
