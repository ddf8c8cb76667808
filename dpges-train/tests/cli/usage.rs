//! Wrong or missing arguments are rejected and named.

use image::{Rgba, RgbaImage};
use serde_json::{Value, json};

use super::{bytes, fails, folder, json, metrics, ok};

#[test]
fn wrong_usage_is_exit_code_2_and_says_what_is_right() {
    let folder = folder();
    let at = folder.path();
    assert!(fails(at, 2, &["train", "--stepz", "3"]).contains("--steps"));
    assert!(fails(at, 2, &["train", "--preset", "faster"]).contains("default, quick, cpu"));
    assert!(fails(at, 2, &["config", "--preset", "faster"]).contains("default, quick, cpu"));
    assert!(fails(at, 2, &["train", "--set", "train.step=3"]).contains("did you mean `train.steps`"));
    assert!(fails(at, 2, &["train", "--steps", "0"]).contains("at least 1"));
    for factor in ["0", "-1", "inf"] {
        let message = fails(at, 2, &["train", "--steps-scale", factor]);
        assert!(message.contains("--steps-scale") && message.contains("positive, finite"), "{message}");
    }
    assert!(fails(at, 2, &["train", "--steps-scale", "1e-6"]).contains("`train.steps` is 2000 ×"));
    assert!(fails(at, 2, &["ablate"]).contains("--out"));
    assert!(fails(at, 2, &["ablate", "--out", "a", "--only", "full,lobes"]).contains("no-surfel-loss"));
    assert!(fails(at, 2, &["compare"]).contains("--out"));
    assert!(fails(at, 2, &["compare", "--out", "a", "--methods", "dpgas"]).contains("'dpges'"));
    assert!(fails(at, 2, &["compare", "--out", "a", "--seeds", "0"]).contains("--seeds"));
    assert!(fails(at, 2, &["compare", "--out", "a", "--budget", "auto"]).contains("--budget N"));
    assert!(fails(at, 2, &["compare", "--out", "a", "--method", "mcmc"]).contains("--methods"));
    assert!(fails(at, 2, &["train", "--device", "cuda"]).contains("through wgpu"));
    assert!(fails(at, 2, &["train", "--device", "tpu"]).contains("cpu-flex"));
    assert!(fails(at, 2, &["train", "--resume", "--overwrite"]).contains("cannot be used with"));
    assert!(fails(at, 2, &["eval"]).contains("<SCENE>"));
    assert_eq!(std::fs::read_dir(at).unwrap().count(), 0, "nothing is written");
}

#[test]
fn what_is_missing_is_exit_code_1_and_named() {
    let folder = folder();
    let at = folder.path();
    let message = fails(at, 1, &["train", "nowhere/data"]);
    assert!(message.contains("nowhere/data") && message.contains("transforms.json"), "{message}");
    #[cfg(feature = "gpu")]
    assert!(fails(at, 1, &["train", "--device", "wgpu:99"]).contains("device `wgpu:99`"));
    assert!(fails(at, 1, &["train", "--config", "mine.toml"]).contains("mine.toml"));
    assert!(fails(at, 1, &["train", "--resume", "--out", "none"]).contains("none/checkpoint.safetensors"));
    assert!(fails(at, 1, &["eval", "scene.safetensors", "--data", "builtin"]).contains("scene.safetensors"));
    std::fs::write(at.join("broken.safetensors"), "no scene").unwrap();
    assert!(fails(at, 1, &["info", "broken.safetensors"]).contains("broken.safetensors"));
    assert_eq!(std::fs::read_dir(at).unwrap().count(), 1, "nothing else is written");
}

#[test]
fn a_dataset_is_checked() {
    let folder = folder();
    let at = folder.path();
    let text = ok(at, &["data", "builtin", "--max-resolution", "48", "--json", "a.json", "--out", "pictures"]);
    for part in ["24 for training, 6 held out", "48 x 48 px", "points seen", "contact_sheet.png", "cameras.svg"] {
        assert!(text.contains(part), "{part}: {text}");
    }
    let report = json(at.join("a.json"));
    assert_eq!(report["views"].as_array().unwrap().len(), 30);
    assert!(report["views"][0]["exposure"].is_f64(), "{report}");
    let sheet = image::open(at.join("pictures/contact_sheet.png")).unwrap();
    assert!(sheet.width() > 1000 && sheet.height() > 500);
    assert!(String::from_utf8(bytes(at.join("pictures/cameras.svg"))).unwrap().contains("from the side"));
    assert!(fails(at, 1, &["data", "nowhere"]).contains("nowhere"));
    assert!(fails(at, 2, &["data"]).contains("<DATASET>"));
}

#[test]
fn steps_are_scaled_once() {
    let folder = folder();
    let at = folder.path();
    let args = [
        "train",
        "--out=run",
        "--device=cpu",
        "--steps-scale=0.002",
        "--max-resolution=24",
        "--set=init.max_points=100",
    ];
    ok(at, &args);
    assert!(String::from_utf8(bytes(at.join("run/config.toml"))).unwrap().contains("\nsteps = 4\n"));
    ok(at, &[&args[..], &["--resume"]].concat());
    assert_eq!(metrics(&at.join("run")).last().unwrap()["step"], 4);
}

#[test]
fn runs_begin_with_a_stage_of_gaussians_unless_told_otherwise() {
    let folder = folder();
    let at = folder.path();
    std::fs::create_dir(at.join("toy")).unwrap();
    let pose = |x: f64| json!([[1, 0, 0, x], [0, 1, 0, 0], [0, 0, 1, 3], [0, 0, 0, 1]]);
    let frame = |name: &str, x: f64| json!({ "file_path": name, "transform_matrix": pose(x) });
    for split in ["train", "test"] {
        let frames: Vec<Value> = (0..3).map(|i| frame(&format!("{split}_{i}"), f64::from(i) - 1.0)).collect();
        let transforms = json!({ "camera_angle_x": 0.7, "frames": frames }).to_string();
        std::fs::write(at.join(format!("toy/transforms_{split}.json")), transforms).unwrap();
        for i in 0..3 {
            let inside = |x: u32, y: u32| (8..16).contains(&x) && (8..16).contains(&y);
            let picture =
                RgbaImage::from_fn(24, 24, |x, y| Rgba(if inside(x, y) { [200, 80, 40, 255] } else { [0; 4] }));
            picture.save(at.join(format!("toy/{split}_{i}.png"))).unwrap();
        }
    }
    let config = |out: &str| -> toml::Table { String::from_utf8(bytes(at.join(out))).unwrap().parse().unwrap() };
    ok(at, &["train", "toy", "--device=cpu", "--out=stages", "--steps=10"]);
    assert_eq!(config("stages/config.toml")["stages"]["gaussians"].as_float(), Some(0.2));
    assert!(at.join("stages/stage_mcmc.safetensors").is_file());
    ok(at, &["train", "toy", "--out=stages", "--steps=10", "--resume"]);
    ok(at, &["train", "toy", "--device=cpu", "--out=preset", "--steps=10", "--preset=quick"]);
    assert_eq!(config("preset/config.toml")["stages"]["gaussians"].as_float(), Some(0.2));
    ok(at, &["train", "toy", "--device=cpu", "--out=alone", "--steps=4", "--set=stages.gaussians=0"]);
    assert_eq!(config("alone/config.toml")["stages"]["gaussians"].as_float(), Some(0.0));
}

#[cfg(not(feature = "mpi"))]
#[test]
fn a_job_of_an_mpi_launcher_needs_the_feature() {
    let folder = folder();
    let mut command = assert_cmd::Command::cargo_bin("dpges").unwrap();
    command.env("OMPI_COMM_WORLD_RANK", "1").env("OMPI_COMM_WORLD_SIZE", "4").current_dir(folder.path());
    let output = command.args(["train", "--out", "run", "--device", "cpu"]).output().unwrap();
    let message = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(1), "{message}");
    assert!(message.contains("process 1 of 4") && message.contains("--features mpi"), "{message}");
    assert!(!folder.path().join("run").exists());
}
