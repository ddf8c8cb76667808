//! Wrong or missing arguments are rejected and named.

#[cfg(not(feature = "mpi"))]
use super::command;
use super::{assert_contains, content, fails, folder, json, metrics, ok, words};

#[test]
fn wrong_usage_is_exit_code_2_and_says_what_is_right() {
    let at = &folder();
    for (args, part) in [
        ("train --stepz 3", "--steps"),
        ("train --preset faster", "default, quick, cpu"),
        ("config --preset faster", "default, quick, cpu"),
        ("train --set train.step=3", "did you mean `train.steps`"),
        ("train --steps 0", "at least 1"),
        ("train --steps-scale 1e-6", "`train.steps` is 2000 ×"),
        ("ablate", "--out"),
        ("ablate --out a --only full,lobes", "no-surfel-loss"),
        ("compare", "--out"),
        ("compare --out a --methods dpgas", "'dpges'"),
        ("compare --out a --seeds 0", "--seeds"),
        ("compare --out a --budget auto", "--budget N"),
        ("compare --out a --method mcmc", "--methods"),
        ("train --device cuda", "through wgpu"),
        ("train --device tpu", "cpu, wgpu"),
        ("train --resume --overwrite", "cannot be used with"),
        ("eval", "<SCENE>"),
        ("data", "<DATASET>"),
        ("blocks plan builtin", "--out"),
        ("blocks plan builtin --out a --blocks 0", "whole number from 1"),
        ("blocks plan builtin --out a --points many", "whole number from 1"),
        ("blocks plan builtin --out a --set train.poses=on", "train.poses"),
    ] {
        assert_contains(&fails(at, 2, &words(args)), &[part]);
    }
    for factor in ["0", "-1", "inf"] {
        assert_contains(&fails(at, 2, &["train", "--steps-scale", factor]), &["--steps-scale", "positive, finite"]);
    }
    assert_eq!(std::fs::read_dir(at).unwrap().count(), 0, "nothing is written");
}

#[test]
fn what_is_missing_is_exit_code_1_and_named() {
    let at = &folder();
    std::fs::write(at.join("broken.safetensors"), "no scene").unwrap();
    for (args, parts) in [
        ("train nowhere/data", &["there is no folder", "nowhere/data"][..]),
        #[cfg(feature = "gpu")]
        ("train --device wgpu:99", &["device `wgpu:99`"]),
        ("train --config mine.toml", &["mine.toml"]),
        ("train --resume --out none", &["none/checkpoint.safetensors"]),
        ("eval scene.safetensors --data builtin", &["scene.safetensors"]),
        ("info broken.safetensors", &["broken.safetensors"]),
        ("data nowhere", &["nowhere"]),
        ("blocks slurm nowhere", &["blocks plan DATASET"]),
    ] {
        assert_contains(&fails(at, 1, &words(args)), parts);
    }
    assert_eq!(std::fs::read_dir(at).unwrap().count(), 1, "nothing else is written");
}

#[test]
fn a_dataset_is_checked() {
    let at = &folder();
    let text = ok(at, &["data", "builtin", "--max-resolution", "48", "--json", "a.json", "--out", "pictures"]);
    assert_contains(
        &text,
        &["24 for training, 6 held out", "48 x 48 px", "points seen", "contact_sheet.png", "cameras.svg"],
    );
    let report = json(at.join("a.json"));
    assert_eq!(report["views"].as_array().unwrap().len(), 30);
    assert!(report["views"][0]["exposure"].is_f64(), "{report}");
    let sheet = image::open(at.join("pictures/contact_sheet.png")).unwrap();
    assert!(sheet.width() > 1000 && sheet.height() > 500);
    assert!(content(at.join("pictures/cameras.svg")).contains("from the side"));
}

#[test]
fn steps_are_scaled_once() {
    let at = &folder();
    let small = ["--max-resolution=24", "--set=init.max_points=100"];
    let args = [&["train", "--out=run", "--device=cpu", "--steps-scale=0.002"], &small[..]].concat();
    ok(at, &args);
    assert!(content(at.join("run/config.toml")).contains("\nsteps = 4\n"));
    ok(at, &[&args[..], &["--resume"]].concat());
    assert_eq!(metrics(&at.join("run")).last().unwrap()["step"], 4);
}

#[cfg(not(feature = "mpi"))]
#[test]
fn a_job_of_an_mpi_launcher_needs_the_feature() {
    let at = &folder();
    let mut command = command(at);
    command.env("OMPI_COMM_WORLD_RANK", "1").env("OMPI_COMM_WORLD_SIZE", "4");
    let output = command.args(["train", "--out", "run", "--device", "cpu"]).output().unwrap();
    let message = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(1), "{message}");
    assert!(message.contains("process 1 of 4") && message.contains("--features mpi"), "{message}");
    assert!(!at.join("run").exists());
}
