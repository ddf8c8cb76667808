//! A capture in blocks, step by step.

use std::path::Path;

use super::{TINY, bytes, fails, folder, is_equal, json, ok, said};
#[cfg(unix)]
use super::{kill, start, wait_until};

fn plan(at: &Path, out: &str) -> String {
    let options: Vec<&str> = TINY.into_iter().filter(|option| !option.starts_with("--device")).collect();
    ok(at, &[&["blocks", "plan", "builtin", "--out", out, "--blocks", "2"], &options[..]].concat())
}

fn step<'a>(name: &'a str, out: &'a str) -> [&'a str; 4] {
    ["blocks", name, out, "--device=cpu"]
}

#[test]
fn two_blocks_are_planned_trained_and_merged_and_nothing_is_done_twice() {
    let at = &folder();
    let text = plan(at, "city");
    assert!(text.contains("the coarse scene: `dpges blocks coarse") && text.contains("block 1: `"), "{text}");
    for (step, missing) in [("train", "blocks coarse"), ("merge", "blocks coarse")] {
        assert!(fails(at, 1, &["blocks", step, "city", "--device=cpu"]).contains(missing), "{step}");
    }
    ok(at, &step("coarse", "city"));
    ok(at, &[&step("train", "city")[..], &["--block", "1"]].concat());
    assert!(fails(at, 1, &step("merge", "city")).contains("block 0 is not trained yet"));
    ok(at, &step("train", "city"));
    let text = ok(at, &step("merge", "city"));
    assert!(text.contains("the merge: done"), "{text}");

    let done = |step: &str| json(at.join("city").join(step).join("done.json"));
    let kept = |name: &str| ["surfels", "gaussians"].map(|kind| done(name)[kind].as_u64().unwrap());
    let blocks = [kept("block-0"), kept("block-1")];
    assert!(kept("merged")[1] <= blocks[0][1] + blocks[1][1] && kept("merged")[0] > 0, "{blocks:?}");
    let score = |step: &str| json(at.join("city").join(step).join("eval.json"))["psnr"].as_f64().unwrap();
    let [merged, coarse] = ["merged", "coarse"].map(score);
    assert!(merged > coarse - 1.0, "{merged} dB, {coarse} dB of the coarse scene");
    ok(at, &["info", "city/merged"]);

    // the same commands again do nothing
    let files = ["coarse", "block-0", "block-1", "merged"].map(|step| at.join("city").join(step).join("run.json"));
    let times = || files.each_ref().map(|file| file.metadata().unwrap().modified().unwrap());
    let before = (times(), bytes(at.join("city/merged/scene.safetensors")));
    plan(at, "city");
    for name in ["coarse", "train", "merge"] {
        assert!(said(at, &step(name, "city")).contains("done already"), "{name}");
    }
    assert!(before == (times(), bytes(at.join("city/merged/scene.safetensors"))));
    let other = fails(at, 1, &["blocks", "plan", "builtin", "--out", "city", "--blocks", "2", "--steps", "7"]);
    assert!(other.contains("another plan") && other.contains("train.steps"), "{other}");
    assert!(fails(at, 2, &[&step("train", "city")[..], &["--block", "7"]].concat()).contains("from 0"));
}

#[cfg(unix)]
#[test]
fn a_block_that_was_killed_goes_on_where_it_was() {
    let at = &folder();
    for out in ["whole", "killed"] {
        plan(at, out);
        ok(at, &step("coarse", out));
    }
    ok(at, &[&step("train", "whole")[..], &["--block=0"]].concat());
    let child = start(at, &[&step("train", "killed")[..], &["--block=0"]].concat());
    wait_until(|| at.join("killed/block-0/checkpoint.safetensors").is_file());
    kill(child);
    assert!(!at.join("killed/block-0/done.json").exists());
    let again = said(at, &[&step("train", "killed")[..], &["--block=0"]].concat());
    assert!(again.contains("resuming after step"), "{again}");
    assert!(is_equal(at.join("whole/block-0/scene.safetensors"), at.join("killed/block-0/scene.safetensors")));
    assert_eq!(json(at.join("killed/plan.json"))["cameras_by"], "coarse_scene");
}
