//! The `dpges` binary as a process: exit codes, messages, files.

use std::path::{Path, PathBuf};
use std::process::Output;

use assert_cmd::Command;
use dpges_train::metrics::lpips::Network;
use image::{Rgba, RgbaImage};
use safetensors::Dtype;
use safetensors::tensor::TensorView;
use serde_json::{Map, Value, json};
use tempfile::TempDir;

/// A run of a few seconds: every kind of event happens, the scene changes its size. On the CPU, where the same seed
/// gives the same bytes.
const TINY: [&str; 9] = [
    "--device=cpu",
    "--max-resolution=32",
    "--steps=60",
    "--set=init.max_points=400",
    "--set=train.evaluate_every=25",
    "--set=train.checkpoint_every=20",
    "--set=train.picture_views=2",
    "--budget=1500",
    "--seed=3",
];

fn dpges(folder: &Path, args: &[&str]) -> Output {
    Command::cargo_bin("dpges").unwrap().current_dir(folder).args(args).output().unwrap()
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

/// A file for `--lpips` with arbitrary weights.
fn write_network(path: &Path) {
    let tensors: Vec<(String, Vec<usize>, Vec<u8>)> = Network::Alex
        .tensors()
        .into_iter()
        .map(|tensor| {
            let value = |i: usize| (i * 37 % 101) as f32 / 1000.0;
            let bytes = (0..tensor.shape.iter().product()).flat_map(|i| value(i).to_le_bytes()).collect();
            (tensor.name, tensor.shape, bytes)
        })
        .collect();
    let views = tensors
        .iter()
        .map(|(name, shape, bytes)| (name.as_str(), TensorView::new(Dtype::F32, shape.clone(), bytes).unwrap()));
    let metadata = [("network", "alex"), ("version", "0.1")].map(|(key, value)| (key.to_owned(), value.to_owned()));
    safetensors::serialize_to_file(views, Some(metadata.into()), path).unwrap();
}

fn folder() -> TempDir {
    tempfile::tempdir().unwrap()
}

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
fn a_series_begins_with_no_run_if_one_cannot_be_trained() {
    let folder = folder();
    let at = folder.path();
    let lens = ["--set=data.builtin_lens=fisheye", "--set=data.undistort=false"];
    let compare = ["compare", "--out=study", "--device=cpu", "--steps=5", "--max-resolution=32"];
    let message = fails(at, 1, &[&compare[..], &["--methods=dpges,2dgs"], &lens].concat());
    for part in ["2dgs: discs cannot be seen through a lens", "data.undistort", "leave it out"] {
        assert!(message.contains(part), "{part}: {message}");
    }
    assert!(!at.join("study/dpges").exists(), "nothing is trained for nothing");
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
fn a_run_writes_everything_and_can_be_measured_and_shown() {
    let folder = folder();
    let at = folder.path();
    let table = train(at, "run", &[]);
    let run = at.join("run");
    for part in ["60 steps", "held-out PSNR", "surfels", "run/scene.safetensors"] {
        assert!(table.contains(part), "{part}: {table}");
    }
    let config = String::from_utf8(bytes(run.join("config.toml"))).unwrap();
    assert!(config.contains("steps = 60") && config.contains("budget = 1500"), "{config}");
    assert_eq!(json(run.join("run.json"))["dataset"], "builtin");

    let lines = metrics(&run);
    let steps = |kind: &str| -> Vec<u64> {
        let of_kind = lines.iter().filter(|line| line["kind"] == kind);
        of_kind.map(|line| line["step"].as_u64().unwrap()).collect()
    };
    assert_eq!(steps("evaluation"), [25, 50, 60]);
    assert!([10, 20, 30, 40, 50, 60].iter().all(|step| steps("step").contains(step)));
    assert!(lines.iter().any(|line| line.contains_key("events")), "refinement is logged");
    assert_eq!(png_names(&run.join("pictures")).len(), 3 * 2);

    let written = json(run.join("eval.json"));
    let size = bytes(run.join("scene.safetensors")).len() as u64;
    assert_eq!((written["bytes"].as_u64(), written["split"].as_str()), (Some(size), Some("test")));
    let result = ok(at, &["eval", "run", "--save-images", "views", "--device=cpu"]);
    let mut measured: Value = serde_json::from_str(&result).unwrap();
    assert_eq!(measured["views"].as_array().unwrap().len(), 6);
    for key in ["name", "psnr", "ssim", "flip", "ssimulacra2", "seconds", "width", "height"] {
        assert!(measured["views"][0].get(key).is_some(), "{key}");
    }
    assert!(measured["psnr"].as_f64().unwrap() > 10.0 && measured["seconds_per_view"].as_f64().unwrap() > 0.0);
    assert_eq!(png_names(&at.join("views")).len(), 6);
    measured["scene"] = written["scene"].clone();
    let times = |value: &Value| {
        let mut value = value.clone();
        value["seconds_per_view"] = Value::Null;
        value["peak_memory_bytes"] = Value::Null;
        value["views"].as_array_mut().unwrap().iter_mut().for_each(|view| view["seconds"] = Value::Null);
        value
    };
    assert_eq!(times(&measured), times(&written), "the file in the run says the same");
    assert!(measured["training_seconds"].as_f64().unwrap() > 0.0);
    assert_eq!(measured["peak_memory_bytes"].is_u64(), cfg!(target_os = "linux"));
    let absent = ["ms_ssim", "lpips_alex", "lpips_vgg", "popping", "frame_ms"];
    assert!(absent.iter().all(|key| measured.get(key).is_none()), "{measured}");

    let table = ok(at, &["eval", "run/scene.safetensors", "--device=cpu", "--split", "train", "--json", "train.json"]);
    assert!(table.contains("mean"));
    assert_eq!(json(at.join("train.json"))["views"].as_array().unwrap().len(), 24);

    std::fs::copy(run.join("scene.safetensors"), at.join("alone.safetensors")).unwrap();
    assert!(fails(at, 2, &["eval", "alone.safetensors"]).contains("--data"));
    let small = ["eval", "alone.safetensors", "--data", "builtin", "--max-resolution", "32", "--device=cpu"];
    let small = ok(at, &small);
    assert_eq!(serde_json::from_str::<Value>(&small).unwrap()["psnr"], written["psnr"]);

    ok(at, &["render", "run", "--out", "layers", "--layers"]);
    let names = png_names(&at.join("layers"));
    assert_eq!(names.len(), 6 * 7);
    for part in ["", "_surfels", "_depth", "_normal", "_transmittance_1", "_transmittance_3"] {
        assert!(names.contains(&format!("test_000{part}.png")), "{part}: {names:?}");
    }
    let ranges = json(at.join("layers/layers.json"));
    assert!(ranges[0]["depth_near"].as_f64().unwrap() < ranges[0]["depth_far"].as_f64().unwrap());

    assert!(ok(at, &["info", "run"]).contains("colour_model"));
    let lobes = 2 * (written["surfels"].as_u64().unwrap() + written["gaussians"].as_u64().unwrap());
    let info: Value = serde_json::from_str(&ok(at, &["info", "run", "--json"])).unwrap();
    assert_eq!((&info["surfels"], &info["bytes"]), (&written["surfels"], &written["bytes"]));
    assert_eq!(info["lobes"].as_array().unwrap().iter().map(|n| n.as_u64().unwrap()).sum::<u64>(), lobes);
}

#[test]
fn popping_and_frame_times_are_measured_when_asked_for() {
    let folder = folder();
    let at = folder.path();
    train(at, "run", &["--set=train.evaluate_every=0"]);
    let table = ok(at, &["eval", "run", "--device=cpu", "--popping", "--frame-times", "--json=result.json"]);
    assert!(table.contains("FLIP_1") && table.contains("over 60 frames"), "{table}");
    let result = json(at.join("result.json"));
    let popping = &result["popping"];
    assert_eq!(popping["frames"], 60);
    for key in ["flip_1", "flip_7"] {
        assert!(popping[key].as_f64().is_some_and(|flip| flip > 0.0 && flip < 1.0), "{popping}");
    }
    let shares = popping["pixels_compared"].as_array().unwrap();
    assert!(shares.len() == 2 && shares.iter().all(|share| share.as_f64().unwrap() <= 1.0), "{popping}");
    match result.get("frame_ms") {
        Some(times) => {
            assert!(times["p50"].as_f64().unwrap() > 0.0 && times["p99"].as_f64() >= times["p50"].as_f64(), "{times}");
            assert_eq!(
                (&times["width"], &times["height"], &times["renderer"]),
                (&32.into(), &32.into(), &"raster".into())
            );
            assert!(table.contains(times["device"].as_str().unwrap()), "{table}");
        }
        None => assert!(table.contains("not measured: ") && table.contains("adapter"), "{table}"),
    }
}

#[test]
fn lpips_is_measured_with_a_network_and_worst_views_are_shown() {
    let folder = folder();
    let at = folder.path();
    train(at, "run", &["--steps=20", "--set=train.evaluate_every=0"]);
    write_network(&at.join("alex.safetensors"));
    let eval = ["eval", "run", "--device=cpu"];
    let without = dpges(at, &eval);
    let said = String::from_utf8(without.stderr).unwrap();
    assert!(said.contains("LPIPS") && said.contains("lpips_weights.py") && said.contains("SSIMULACRA2"), "{said}");

    let more = ["--lpips=alex.safetensors", "--worst=worst", "--json=result.json"];
    let table = ok(at, &[&eval[..], &more].concat());
    for part in ["LPIPS (Alex)", "SSIMULACRA2", "worst", "worst/worst_psnr.png"] {
        assert!(table.contains(part), "{part}: {table}");
    }
    assert!(!table.contains("not measured") && !table.contains("MS-SSIM"), "{table}");
    let result = json(at.join("result.json"));
    let views = result["views"].as_array().unwrap();
    let mean = views.iter().map(|view| view["lpips_alex"].as_f64().unwrap()).sum::<f64>() / views.len() as f64;
    assert!(mean > 0.0 && (result["lpips_alex"].as_f64().unwrap() - mean).abs() < 1e-12, "{result}");
    assert!(result.get("lpips_vgg").is_none());
    let names = ["flip", "lpips_alex", "psnr", "ssim", "ssimulacra2"].map(|metric| format!("worst_{metric}.png"));
    assert_eq!(png_names(&at.join("worst")), names);
    let picture = image::open(at.join("worst/worst_flip.png")).unwrap();
    assert_eq!((picture.width(), picture.height()), (3 * 32 + 2 * 2, 32));

    let twice = [&eval[..], &["--lpips=alex.safetensors", "--lpips=alex.safetensors"]].concat();
    assert!(fails(at, 2, &twice).contains("both hold network `alex`"));
    std::fs::write(at.join("vgg.safetensors"), "no tensors").unwrap();
    let broken = fails(at, 1, &[&eval[..], &["--lpips=vgg.safetensors"]].concat());
    assert!(broken.contains("vgg.safetensors") && broken.contains("docs/metrics.md"), "{broken}");
    let scene = fails(at, 1, &[&eval[..], &["--lpips=run/scene.safetensors"]].concat());
    assert!(scene.contains("run/scene.safetensors") && scene.contains("`network`"), "{scene}");
}

#[test]
fn a_compressed_scene_is_smaller_and_read_like_any_other() {
    let folder = folder();
    let at = folder.path();
    train(at, "run", &[]);
    let compress = |args: &[&str]| ok(at, &[&["compress", "run", "--device=cpu"], args].concat());
    let report = |name: &str| json(at.join(name));
    let number = |report: &Value, key: &str| report[key].as_f64().unwrap_or_else(|| panic!("{key}: {report}"));
    let loss = |report: &Value| number(report, "psnr_before") - number(report, "psnr_after");

    let table = compress(&["--out", "medium", "--json", "medium.json"]);
    assert!(table.contains("times smaller") && table.contains("6 views, split `test`"), "{table}");
    let medium = report("medium.json");
    assert_eq!(number(&medium, "bytes_before"), bytes(at.join("run/scene.safetensors")).len() as f64);
    assert_eq!(number(&medium, "bytes_after"), bytes(at.join("medium")).len() as f64);
    assert!(number(&medium, "ratio") > 1.5 && loss(&medium) < 1.0, "{medium}");
    assert!(number(&medium["attributes"]["gaussians.positions"], "bits_before") == 96.0);
    compress(&["--out", "again"]);
    assert!(is_equal(at.join("medium"), at.join("again")));

    let info = |scene: &str| serde_json::from_str::<Value>(&ok(at, &["info", scene, "--json"])).unwrap();
    let (before, after) = (info("run"), info("medium"));
    for key in ["surfels", "gaussians", "colour_model", "lobes", "rendering", "background", "extent"] {
        assert_eq!(before[key], after[key], "{key}");
    }
    let measured = ok(at, &["eval", "medium", "--data=builtin", "--max-resolution=32", "--device=cpu"]);
    let measured: Value = serde_json::from_str(&measured).unwrap();
    assert!((number(&measured, "psnr") - number(&medium, "psnr_after")).abs() < 1e-6);

    compress(&["--out", "low", "--quality", "low", "--json", "low.json"]);
    let low = report("low.json");
    let [small, large] = [&low, &medium].map(|report| number(report, "bytes_after") as usize);
    assert!(small < large);
    let between = (small + large) / 2;
    compress(&["--out", "between", "--target", &format!("{}MB", between as f64 / 1e6)]);
    assert!((small..=between).contains(&bytes(at.join("between")).len()));
    let message = fails(at, 1, &["compress", "run", "--device=cpu", "--out", "tiny", "--target", "0.001MB"]);
    assert!(message.contains(&small.to_string()) && message.contains("--target"), "{message}");

    let allowed = loss(&medium).max(0.05);
    compress(&["--out", "close", "--target", &format!("{allowed}dB"), "--json", "close.json"]);
    let close = report("close.json");
    assert!(loss(&close) <= allowed && number(&close, "bytes_after") <= number(&medium, "bytes_after"), "{close}");

    std::fs::copy(at.join("run/scene.safetensors"), at.join("alone.safetensors")).unwrap();
    let table = ok(at, &["compress", "alone.safetensors", "--out", "alone"]);
    assert!(table.contains("not measured") && is_equal(at.join("alone"), at.join("medium")), "{table}");
    let refused = |args: &[&str]| fails(at, 2, &[&["compress", "alone.safetensors"], args].concat());
    assert!(refused(&["--out", "no", "--target", "0.1dB"]).contains("--data"));
    assert!(refused(&["--out", "no", "--target", "7"]).contains("such as 10MB"));
    assert!(refused(&["--out", "no", "--target", "1MB", "--quality", "low"]).contains("cannot be used with"));
    assert!(refused(&["--out", "alone.safetensors"]).contains("--out is the scene itself"));
    assert!(!at.join("no").exists() && !at.join("tiny").exists());
}

#[test]
fn equal_seeds_give_equal_files_and_a_run_is_not_overwritten_by_accident() {
    let folder = folder();
    let at = folder.path();
    train(at, "a", &["--quiet"]);
    assert!(train(at, "b", &["--quiet"]).is_empty());
    assert!(is_equal(at.join("a/scene.safetensors"), at.join("b/scene.safetensors")));
    assert!(is_equal(at.join("a/checkpoint.safetensors"), at.join("b/checkpoint.safetensors")));
    let message = fails(at, 1, &["train", "--out", "a"]);
    assert!(message.contains("--overwrite") && message.contains("--resume"), "{message}");
    train(at, "c", &["--quiet", "--deterministic"]);
    assert!(String::from_utf8(bytes(at.join("c/config.toml"))).unwrap().contains("deterministic = true"));
    assert!(is_equal(at.join("a/scene.safetensors"), at.join("c/scene.safetensors")), "CPUs always are");
    train(at, "a", &["--seed=4", "--overwrite"]);
    assert!(!is_equal(at.join("a/scene.safetensors"), at.join("b/scene.safetensors")));
}

#[test]
fn a_finished_run_resumes_to_itself_and_contradictions_are_refused() {
    let folder = folder();
    let at = folder.path();
    train(at, "run", &[]);
    std::fs::copy(at.join("run/scene.safetensors"), at.join("before.safetensors")).unwrap();
    let lines = metrics(&at.join("run"));
    assert!(ok(at, &["train", "--out", "run", "--resume"]).contains("held-out PSNR"));
    assert!(is_equal(at.join("run/scene.safetensors"), at.join("before.safetensors")));
    assert_eq!(metrics(&at.join("run")), lines);
    let message = fails(at, 2, &["train", "--out", "run", "--resume", "--steps", "70"]);
    assert!(message.contains("`train.steps` is 60, not 70"), "{message}");
    assert!(fails(at, 2, &["train", "data", "--out", "run", "--resume"]).contains("builtin"));
    assert!(fails(at, 2, &["train", "--out", "run", "--resume", "--preset", "cpu"]).contains("`init.max_points`"));
    std::fs::write(at.join("run/checkpoint.safetensors"), "half").unwrap();
    assert!(fails(at, 1, &["train", "--out", "run", "--resume"]).contains("checkpoint.safetensors"));
}

#[test]
fn a_step_that_is_not_finite_ends_the_run_with_the_state_before_it() {
    let folder = folder();
    let at = folder.path();
    let broken = [&["train", "--out", "run", "--set=train.lambda_surfel=1e39"], &TINY[..]].concat();
    let message = fails(at, 1, &broken);
    assert!(message.contains("step 1, view `train_") && message.contains("the loss is inf"), "{message}");
    assert!(message.contains("checkpoint.safetensors holds the state after step 1"), "{message}");
    let info: Value = serde_json::from_str(&ok(at, &["info", "run", "--json"])).unwrap();
    assert!(info["gaussians"].as_u64().unwrap() > 0);
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
fn blender_scenes_begin_with_a_stage_of_gaussians_unless_told_otherwise() {
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
    assert_eq!(config("stages/config.toml")["stages"]["gaussians"].as_float(), Some(0.3));
    assert!(at.join("stages/stage_mcmc.safetensors").is_file());
    ok(at, &["train", "toy", "--out=stages", "--steps=10", "--resume"]);
    ok(at, &["train", "toy", "--device=cpu", "--out=preset", "--steps=10", "--preset=quick"]);
    assert_eq!(config("preset/config.toml")["stages"]["gaussians"].as_float(), Some(0.3));
    ok(at, &["train", "toy", "--device=cpu", "--out=alone", "--steps=4", "--set=stages.gaussians=0"]);
    assert_eq!(config("alone/config.toml")["stages"]["gaussians"].as_float(), Some(0.0));
}

#[test]
fn variants_are_trained_once_and_compared() {
    let folder = folder();
    let at = folder.path();
    let args = [
        "ablate",
        "--out=study",
        "--device=cpu",
        "--steps=6",
        "--seed=3",
        "--max-resolution=32",
        "--budget=900",
        "--only=sh,full",
    ];
    let table = ok(at, &args);
    for part in ["full", "sh", "dB", "Gaussians", "ablation.csv", "ablation.svg"] {
        assert!(table.contains(part), "{part}: {table}");
    }
    let csv = String::from_utf8(bytes(at.join("study/ablation.csv"))).unwrap();
    let lines: Vec<Vec<&str>> = csv.lines().map(|line| line.split(',').collect()).collect();
    assert_eq!(lines[0], ["variant", "psnr", "ssim", "surfels", "gaussians", "bytes", "seconds"]);
    assert_eq!((lines[1][0], lines[2][0], lines.len()), ("full", "sh", 3));
    for line in &lines[1..] {
        let run = at.join("study").join(line[0]).join("seed_3");
        let written = json(run.join("eval.json"));
        assert!((line[1].parse::<f64>().unwrap() - written["psnr"].as_f64().unwrap()).abs() < 1e-4, "{csv}");
        assert_eq!(line[5].parse::<u64>().unwrap(), bytes(run.join("scene.safetensors")).len() as u64);
        let config = String::from_utf8(bytes(run.join("config.toml"))).unwrap();
        assert_eq!(config.contains("colour = \"sh3\""), line[0] == "sh", "{config}");
        assert!(config.contains("\nsteps = 6\n") && config.contains("\nseed = 3\n"), "{config}");
    }
    assert!(String::from_utf8(bytes(at.join("study/ablation.svg"))).unwrap().starts_with("<svg "));

    // finished, finished but for its evaluation
    let [full, sh] = ["full", "sh"].map(|variant| at.join("study").join(variant).join("seed_3"));
    let (log, scene) = (bytes(full.join("metrics.jsonl")), bytes(sh.join("scene.safetensors")));
    std::fs::remove_file(sh.join("eval.json")).unwrap();
    ok(at, &args);
    assert!(bytes(full.join("metrics.jsonl")) == log, "it is not trained again");
    assert!(bytes(sh.join("scene.safetensors")) == scene && sh.join("eval.json").is_file());
    assert_eq!(String::from_utf8(bytes(at.join("study/ablation.csv"))).unwrap(), csv);

    // a second seed
    let table = ok(at, &[&args[..], &["--seeds=2"]].concat());
    assert!(table.contains(" ± ") && table.contains("over 2 seeds"), "{table}");
    assert!(bytes(full.join("metrics.jsonl")) == log, "the first is not trained again");
    let second =
        |variant: &str| json(at.join("study").join(variant).join("seed_4/eval.json"))["psnr"].as_f64().unwrap();
    let first = |line: &[&str]| line[1].parse::<f64>().unwrap();
    let csv = String::from_utf8(bytes(at.join("study/ablation.csv"))).unwrap();
    let of_both: Vec<Vec<&str>> = csv.lines().map(|line| line.split(',').collect()).collect();
    let mean = (first(&lines[2]) + second("sh")) / 2.0;
    let difference = mean - (first(&lines[1]) + second("full")) / 2.0;
    let column = |name: &str| of_both[0].iter().position(|column| *column == name).unwrap();
    for (name, expected) in [("psnr", mean), ("psnr_difference", difference)] {
        assert!((of_both[2][column(name)].parse::<f64>().unwrap() - expected).abs() < 2e-4, "{name}: {csv}");
    }
    assert!(of_both[2][column("psnr_deviation")].parse::<f64>().unwrap() > 0.0, "{csv}");

    let message = fails(at, 1, &[&args[..], &["--budget=901"]].concat());
    assert!(message.contains("study/full/seed_3 holds another run") && message.contains("`refine.budget` is 900"));
    assert!(ok(at, &["info", "study/sh/seed_3"]).contains("margin_lookup"));
}

#[test]
fn methods_are_trained_once_and_compared() {
    let folder = folder();
    let at = folder.path();
    let args = [
        "compare",
        "builtin",
        "--out=study",
        "--device=cpu",
        "--methods=mcmc,dpges",
        "--seeds=2",
        "--seed=3",
        "--steps=12",
        "--max-resolution=32",
        "--budget=700",
        "--set=data.validation_every=4",
        "--set=train.evaluate_every=0",
        "--set=train.checkpoint_every=4",
        "--set=init.max_points=300",
    ];
    let table = ok(at, &args);
    for part in ["| mcmc", "| dpges", " ± ", "to mcmc", "validation PSNR", "at most 700 primitives", "comparison.csv"]
    {
        assert!(table.contains(part), "{part}: {table}");
    }
    let comparison = json(at.join("study/comparison.json"));
    assert_eq!((&comparison["steps"], &comparison["budget"]), (&Value::from(12), &Value::from(700)));
    assert_eq!(comparison["seeds"], json!([3, 4]));
    for (method, name) in comparison["methods"].as_array().unwrap().iter().zip(["mcmc", "dpges"]) {
        assert_eq!(method["method"], name);
        assert_eq!(method["settings"][0], format!("train.method={name}"));
        let runs = method["runs"].as_array().unwrap();
        let psnr: Vec<f64> = runs.iter().map(|run| run["test"]["psnr"].as_f64().unwrap()).collect();
        assert!((method["psnr"]["mean"].as_f64().unwrap() - (psnr[0] + psnr[1]) / 2.0).abs() < 1e-9, "{method}");
        let half = (psnr[0] - psnr[1]).abs() / 2f64.sqrt();
        assert!((method["psnr"]["deviation"].as_f64().unwrap() - half).abs() < 1e-9 && half > 0.0, "{method}");
        for run in runs {
            let path = at.join("study").join(run["folder"].as_str().unwrap());
            let (test, kept) = (json(path.join("eval.json")), json(path.join("validation.json")));
            assert_eq!((&run["test"]["psnr"], &run["validation"]["psnr"]), (&test["psnr"], &kept["psnr"]));
            assert_eq!((&test["split"], &kept["split"]), (&"test".into(), &"validation".into()));
            assert!(kept["views"][0]["name"].as_str().unwrap().starts_with("train"), "{kept}");
            let config = String::from_utf8(bytes(path.join("config.toml"))).unwrap();
            assert!(config.contains("\nbudget = 700\n") && config.contains(&format!("\nseed = {}\n", run["seed"])));
        }
    }
    let sheets = comparison["pictures"]["sheets"].as_array().unwrap();
    assert_eq!((sheets.len(), &comparison["pictures"]["columns"]), (3, &json!(["photograph", "mcmc", "dpges"])));
    for sheet in sheets {
        let picture = image::open(at.join("study").join(sheet["file"].as_str().unwrap())).unwrap();
        assert_eq!((picture.width(), picture.height()), (3 * 32 + 2 * 2, 2 * 32 + 2), "{sheet}");
    }
    let views = json(at.join("study/mcmc/seed_3/eval.json"))["views"].clone();
    let lowest = views.as_array().unwrap().iter().map(|view| view["psnr"].as_f64().unwrap()).fold(f64::MAX, f64::min);
    assert_eq!((&sheets[0]["psnr"][0], &sheets[0]["chosen"]), (&Value::from(lowest), &Value::from("worst")));
    assert!(String::from_utf8(bytes(at.join("study/comparison.svg"))).unwrap().contains(" ± "));

    // again: nothing is trained; then a run as it is left by an interruption
    let run = |name: &str| at.join("study").join(name);
    let log = bytes(run("dpges/seed_4/metrics.jsonl"));
    let written = bytes(at.join("study/comparison.json"));
    assert_eq!(ok(at, &args), table);
    assert!(bytes(run("dpges/seed_4/metrics.jsonl")) == log && bytes(at.join("study/comparison.json")) == written);
    write_network(&at.join("alex.safetensors"));
    let table = ok(at, &[&args[..], &["--lpips=alex.safetensors"]].concat());
    assert!(table.contains("LPIPS (Alex)") && table.contains("SSIMULACRA2"), "{table}");
    assert!(bytes(run("dpges/seed_4/metrics.jsonl")) == log);
    let with = json(at.join("study/comparison.json"));
    for method in with["methods"].as_array().unwrap() {
        let of_run = |seed: u64| {
            let folder = format!("{}/seed_{seed}", method["method"].as_str().unwrap());
            json(run(&folder).join("eval.json"))["lpips_alex"].as_f64().unwrap()
        };
        let mean = (of_run(3) + of_run(4)) / 2.0;
        assert!(mean > 0.0 && (method["lpips_alex"]["mean"].as_f64().unwrap() - mean).abs() < 1e-12, "{method}");
    }
    assert!(ok(at, &args).contains("LPIPS (Alex)"), "it stays in the files of the runs");

    let pops = [&args[..], &["--popping"]].concat();
    assert!(ok(at, &pops).contains("FLIP_7"));
    for method in ["mcmc", "dpges"] {
        let popping = json(run(method).join("seed_3/eval.json"))["popping"].clone();
        assert!(popping["flip_7"].as_f64().unwrap() > 0.0 && popping["frames"] == 60, "{popping}");
    }
    let again = String::from_utf8(dpges(at, &pops).stderr).unwrap();
    assert!(!again.contains("measuring popping"), "{again}");
    assert!(ok(at, &args).contains("FLIP_7"), "it stays there too");

    let scene = bytes(run("mcmc/seed_3/scene.safetensors"));
    for file in ["eval.json", "validation.json"] {
        std::fs::remove_file(run("mcmc/seed_3").join(file)).unwrap();
    }
    std::fs::remove_dir_all(run("dpges/seed_3")).unwrap();
    let output = dpges(at, &args);
    let messages = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(0), "{messages}");
    for part in ["mcmc, seed 3: resumed", "mcmc, seed 4: already finished", "dpges, seed 3: 12 steps"] {
        assert!(messages.contains(part), "{part}: {messages}");
    }
    let scores =
        |comparison: Value| comparison["methods"].as_array().unwrap().iter().map(|m| m["psnr"].clone()).collect();
    let (before, after): (Vec<Value>, Vec<Value>) =
        (scores(comparison), scores(json(at.join("study/comparison.json"))));
    assert_eq!(before, after);
    assert!(bytes(run("mcmc/seed_3/scene.safetensors")) == scene);

    #[cfg(unix)]
    {
        let again = [&args[..], &["--out=killed"]].concat();
        let mut child = start(at, &again);
        wait_until(|| at.join("killed/mcmc/seed_3/checkpoint.safetensors").is_file());
        child.kill().unwrap();
        child.wait().unwrap();
        ok(at, &again);
        for name in ["mcmc/seed_3", "mcmc/seed_4", "dpges/seed_3", "dpges/seed_4"] {
            assert!(is_equal(
                run(name).join("scene.safetensors"),
                at.join("killed").join(name).join("scene.safetensors")
            ));
        }
    }

    let message = fails(at, 1, &[&args[..], &["--steps=13"]].concat());
    assert!(message.contains("study/mcmc/seed_3 holds another run") && message.contains("`train.steps` is 12"));
}

#[test]
fn the_first_line_says_which_device_and_why() {
    let folder = folder();
    let at = folder.path();
    let first_line = |args: &[&str]| -> String {
        let output = dpges(at, args);
        let message = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(0), "{args:?}: {message}");
        message.lines().next().unwrap().to_owned()
    };
    let short = ["train", "--out=run", "--steps=2", "--max-resolution=24", "--set=init.max_points=100"];
    let trained = first_line(&short);
    let chosen = ok(at, &["devices", "--auto"]);
    let device = chosen.split(',').next().unwrap();
    assert!(trained.contains(&format!("device: {device}, since ")), "{trained}, but {chosen}");
    if device == "cpu" {
        assert!(["no GPU", "no hardware GPU"].iter().any(|part| chosen.contains(part)), "{chosen}");
    } else {
        assert!(device.starts_with("wgpu:") && chosen.contains("passed a check"), "{chosen}");
    }
    assert_eq!(json(at.join("run/run.json"))["device"], device, "a name, not `auto`");

    let again = first_line(&["train", "--out=run", "--resume"]);
    assert!(again.contains(&format!("device: {device} (")) && again.contains("as before"), "{again}");
    assert!(first_line(&["train", "--out=run", "--resume", "--device=auto"]).contains(", since "));
    assert!(first_line(&["eval", "run"]).contains(&format!("device: {device}, since ")));
    let named = first_line(&["render", "run", "--out=pictures", "--device=cpu-flex"]);
    assert!(named.contains("device: cpu-flex (burn-flex on the CPU), as --device says"), "{named}");
    let study = ["ablate", "--out=study", "--only=full", "--steps=2", "--max-resolution=24", "--device=auto"];
    assert!(first_line(&study).contains(&format!("device: {device}, since ")));
    let selection: Value = serde_json::from_str(&ok(at, &["devices", "--auto", "--json"])).unwrap();
    assert_eq!(selection["device"], device);
}

#[test]
fn devices_are_listed_with_what_device_takes() {
    let folder = folder();
    let at = folder.path();
    let table = ok(at, &["devices"]);
    assert!(table.contains("cpu-flex") && table.contains("burn-ndarray") && table.contains("wgpu"), "{table}");
    let list: Value = serde_json::from_str(&ok(at, &["devices", "--json"])).unwrap();
    assert_eq!(list["cpus"][0]["device"], "cpu");
    let adapters = list["adapters"].as_array().unwrap();
    assert_eq!(adapters.is_empty(), list["advice"].is_string(), "{list}");
    for (number, adapter) in adapters.iter().enumerate() {
        assert_eq!(adapter["device"], format!("wgpu:{number}"));
        assert_eq!(adapter["suitable"], Value::from(adapter["shortcoming"].is_null()));
        for key in ["name", "kind", "api", "driver", "storage_binding_bytes", "f32_atomic_add"] {
            assert!(!adapter[key].is_null(), "{key}: {adapter}");
        }
    }
    let has_gpu = adapters.iter().any(|adapter| adapter["suitable"] == true);
    assert!(has_gpu || std::env::var_os("DPGES_REQUIRE_GPU").is_none(), "{list}");
}

#[test]
fn the_cpus_pass_the_selftest() {
    let folder = folder();
    let at = folder.path();
    let table = ok(at, &["selftest", "--device", "cpu"]);
    let parts = ["peel", "splat", "composite", "SSIM", "backward", "burn-ndarray", "all as they should be"];
    assert!(parts.iter().all(|part| table.contains(part)) && !table.contains("WRONG"), "{table}");
    let report: Value = serde_json::from_str(&ok(at, &["selftest", "--device", "cpu-flex", "--json"])).unwrap();
    assert_eq!((&report["passed"], &report["device"]), (&Value::from(true), &Value::from("cpu-flex")));
    assert!(report["tensors"].as_u64().unwrap() > 150, "{report}");
}

#[test]
fn what_a_method_trains_alone_can_be_a_beginning() {
    let folder = folder();
    let at = folder.path();
    let short = ["--steps=20", "--set=train.evaluate_every=0"];
    train(at, "discs", &[&short[..], &["--method=2dgs"]].concat());
    train(at, "gaussians", &[&short[..], &["--method=mcmc"]].concat());
    let rendering = |run: &str| -> Value {
        let info: Value = serde_json::from_str(&ok(at, &["info", run, "--json"])).unwrap();
        info["rendering"].clone()
    };
    assert_eq!((rendering("discs"), rendering("gaussians")), ("discs".into(), "ellipsoids".into()));
    assert!(fails(at, 2, &["render", "discs", "--out", "pictures", "--layers"]).contains("a scene of discs"));
    ok(at, &["render", "discs", "--out", "pictures"]);
    assert_eq!(png_names(&at.join("pictures")).len(), 6);

    let files = ["--init-surfels=discs/scene.safetensors", "--init-gaussians=gaussians/scene.safetensors"];
    let more = [&short[..], &files, &["--set=stages.surfel_opacity=0.1"]].concat();
    train(at, "both", &more);
    assert_eq!(rendering("both"), "peeled");
    let result = json(at.join("both/eval.json"));
    assert!(result["surfels"].as_u64().unwrap() > 0 && result["psnr"].as_f64().unwrap() > 10.0, "{result}");
    ok(at, &["train", "--out", "both", "--resume"]);

    let swapped = ["train", "--out=no", "--max-resolution=32", "--init-gaussians=discs/scene.safetensors"];
    let message = fails(at, 1, &swapped);
    assert!(message.contains("stages.gaussians_from") && message.contains("a scene of discs"), "{message}");
    let other = [&["train", "--out=no", "--max-resolution=32", "--set=model.colour=sh1"], &files[..]].concat();
    assert!(fails(at, 1, &other).contains("its colours are sb2"));
    assert!(!at.join("no").exists());
}

#[test]
fn stages_leave_their_scenes_and_a_killed_run_goes_on_in_the_middle_of_one() {
    let folder = folder();
    let at = folder.path();
    let stages = ["--set=stages.surfels=0.3", "--set=stages.gaussians=0.3", "--set=stages.surfel_opacity=0.1"];
    train(at, "whole", &stages);
    for stage in ["2dgs", "dbs"] {
        let report = json(at.join(format!("whole/stage_{stage}.json")));
        assert!(report["psnr"].as_f64().unwrap() > 5.0, "{report}");
        ok(at, &["eval", &format!("whole/stage_{stage}.safetensors"), "--data", "builtin", "--max-resolution=32"]);
    }
    let named: Vec<Value> = metrics(&at.join("whole")).iter().filter_map(|line| line.get("stage").cloned()).collect();
    for stage in ["2dgs", "dbs", "joint"] {
        assert!(named.contains(&stage.into()), "{named:?}");
    }

    #[cfg(unix)]
    {
        let mut child = start_training(at, "killed", &stages);
        wait_until(|| at.join("killed/stage_2dgs.safetensors").is_file());
        child.kill().unwrap();
        child.wait().unwrap();
        if at.join("killed/checkpoint.safetensors").is_file() {
            ok(at, &["train", "--out", "killed", "--resume"]);
        } else {
            train(at, "killed", &[&stages[..], &["--overwrite"]].concat());
        }
        assert!(is_equal(at.join("whole/scene.safetensors"), at.join("killed/scene.safetensors")));
        assert_eq!(metrics(&at.join("whole")), metrics(&at.join("killed")));
    }
}

#[test]
fn validation_views_end_a_run_with_the_best_scene() {
    let folder = folder();
    let at = folder.path();
    let more = ["--stop=validation", "--set=train.evaluate_every=5", "--set=train.patience=1", "--steps=400"];
    train(at, "run", &more);
    let lines = metrics(&at.join("run"));
    let judged: Vec<(u64, f64)> = lines
        .iter()
        .filter(|line| line["kind"] == "validation")
        .map(|line| (line["step"].as_u64().unwrap(), line["psnr"].as_f64().unwrap()))
        .collect();
    let (last, best) = (judged[judged.len() - 1], judged[judged.len() - 2]);
    assert!(last.0 < 400 && last.1 <= best.1, "{judged:?}");
    assert!(judged[..judged.len() - 1].windows(2).all(|pair| pair[1].1 > pair[0].1), "{judged:?}");
    assert!(is_equal(at.join("run/scene.safetensors"), at.join("run/best.safetensors")));
    assert!(lines.iter().filter(|line| line["kind"] == "validation").all(|line| line["views"] == 3));
    let scene = bytes(at.join("run/scene.safetensors"));
    ok(at, &["train", "--out", "run", "--resume"]);
    assert!(bytes(at.join("run/scene.safetensors")) == scene);
}

#[test]
fn an_automatic_budget_says_what_it_decides_and_why() {
    let folder = folder();
    let at = folder.path();
    train(at, "auto", &["--budget=auto", "--steps=100"]);
    let events: Vec<String> = metrics(&at.join("auto"))
        .iter()
        .filter_map(|line| line.get("events")?.as_array().cloned())
        .flatten()
        .map(|event| event.as_str().unwrap().to_owned())
        .collect();
    let told = [
        "layers instead of 3",
        "% of the covered pixels",
        "lobes",
        "without new Gaussians: ",
        "for twice the primitives, at least 0.05 wanted: ",
    ];
    for part in told {
        assert!(events.iter().any(|event| event.contains(part)), "{part}: {events:?}");
    }
    let control = events.iter().position(|event| event.contains("without new Gaussians")).unwrap();
    let batch = events.iter().position(|event| event.starts_with("batch of ")).unwrap();
    assert!(control < batch, "{events:?}");
    train(at, "size", &["--budget=0.1MB"]);
    assert!(bytes(at.join("size/scene.safetensors")).len() < 105_000);
    assert!(fails(at, 2, &["train", "--budget=12GB"]).contains("12.5MB"));
}

#[test]
fn the_trade_of_speed_and_quality_is_measured_once() {
    let folder = folder();
    let at = folder.path();
    train(at, "run", &["--quiet"]);
    let args = [
        "trade",
        "run",
        "--out=trade",
        "--device=cpu",
        "--renderer=training",
        "--size=24x16",
        "--views=2",
        "--rounds=1",
        "--only=detail,primitives,budget",
    ];
    let table = ok(at, &args);
    for part in ["as trained", "trade.csv", "trade_frame_time.svg", "trade_bytes.png", "report.html"] {
        assert!(table.contains(part), "{part}: {table}");
    }
    let trade = || json(at.join("trade/trade.json"));
    let points = || trade()["points"].as_array().unwrap().clone();
    let point = |label: &str| points().into_iter().find(|point| point["label"] == label).unwrap();
    let singles = ["as trained", "detail=1", "detail=0", "primitives=75%", "primitives=50%", "primitives=25%"];
    let labels: Vec<Value> = points().iter().map(|point| point["label"].clone()).collect();
    assert_eq!(labels[..6], singles.map(Value::from));
    assert!(labels[6..].iter().all(|label| label.as_str().unwrap().contains(" + ")), "{labels:?}");
    let (whole, half, bare) = (point("as trained"), point("primitives=50%"), point("detail=0"));
    let count = |point: &Value| point["surfels"].as_u64().unwrap() + point["gaussians"].as_u64().unwrap();
    assert_eq!(whole["bytes"].as_u64().unwrap(), bytes(at.join("run/scene.safetensors")).len() as u64);
    assert_eq!((count(&half), count(&bare)), (count(&whole).div_ceil(2), count(&whole)));
    assert!(bare["bytes"].as_u64() < whole["bytes"].as_u64() && half["bytes"].as_u64() < whole["bytes"].as_u64());
    assert_eq!(whole["frames"], 2);
    for key in ["psnr", "ssim", "flip", "frame_ms", "frame_p99_ms"] {
        assert!(whole[key].as_f64().unwrap() > 0.0, "{key}: {whole}");
    }
    assert!(whole["device"].as_str().unwrap().contains("by the renderer that is trained with"), "{whole}");
    let frontiers = &trade()["frontiers"];
    assert!(!frontiers["bytes"].as_array().unwrap().is_empty() && frontiers["training_seconds"] == json!([]));
    let csv = String::from_utf8(bytes(at.join("trade/trade.csv"))).unwrap();
    assert_eq!(csv.lines().count(), 1 + points().len());
    let plot = image::open(at.join("trade/trade_bytes.png")).unwrap();
    assert_eq!((plot.width(), plot.height()), (1100, 620));
    assert!(!at.join("trade/trade_training_time.svg").exists());
    let page = String::from_utf8(bytes(at.join("trade/report.html"))).unwrap();
    assert!(page.contains("data:image/jpeg;base64,") && page.contains("<svg ") && !page.contains("src=\"http"));

    // again: nothing is measured; then one point that is missing
    let before = points();
    assert_eq!(ok(at, &args), table);
    assert_eq!(points(), before);
    let mut without = trade();
    without["points"].as_array_mut().unwrap().remove(1);
    std::fs::write(at.join("trade/trade.json"), without.to_string()).unwrap();
    ok(at, &args);
    assert!(points().iter().any(|point| point["label"] == "detail=1"));
    assert!(before.iter().filter(|point| point["label"] != "detail=1").all(|point| points().contains(point)));

    let message = fails(at, 1, &[&args[..], &["--size=25x16"]].concat());
    assert!(message.contains("trade/trade.json holds other measurements: `frame_size` is [24,16], not [25,16]"));
    let message = fails(at, 1, &[&args[..], &["--split=train"]].concat());
    assert!(message.contains("`split` is \"test\", not \"train\""), "{message}");

    // training: first without any time, then with enough
    let trained = [&args[..], &["--train", "--set=train.steps=6", "--set=train.evaluate_every=0"]].concat();
    let left = ok(at, &[&trained[..], &["--time-limit=0.001s"]].concat());
    assert!(left.contains("the same command goes on: ") && left.contains("budget-half, seed 3"), "{left}");
    ok(at, &trained);
    let of_training: Vec<Value> = points().into_iter().filter(|point| point["kind"] == "training").collect();
    let expected = ["trained-again", "budget-half", "budget-quarter", "detail-1", "detail-0"];
    assert_eq!(of_training.iter().map(|point| point["label"].clone()).collect::<Vec<_>>(), expected.map(Value::from));
    assert_eq!(trade()["not_run"], json!([]));
    for point in &of_training {
        assert!(point["training_seconds"].as_f64().unwrap() > 0.0 && point["seed"] == 3, "{point}");
        let run = at.join("trade/runs").join(point["label"].as_str().unwrap()).join("seed_3");
        assert_eq!(point["bytes"].as_u64().unwrap(), bytes(run.join("scene.safetensors")).len() as u64);
    }
    assert!(at.join("trade/trade_training_time.svg").is_file());
    let before = points();
    ok(at, &trained);
    assert_eq!(points(), before);
    let message = fails(at, 1, &[&args[..], &["--train", "--set=train.steps=7"]].concat());
    assert!(message.contains("holds another run"), "{message}");
}

#[test]
fn targets_are_kept_and_what_was_reached_is_said() {
    let folder = folder();
    let at = folder.path();
    let without_budget: Vec<&str> = TINY.into_iter().filter(|option| !option.starts_with("--budget")).collect();
    let table = ok(at, &[&["train", "--out=run", "--target=60kB"], &without_budget[..]].concat());
    assert!(table.contains("60kB: 0.06 MB expected"), "{table}");
    let target = json(at.join("run/eval.json"))["target"].clone();
    assert_eq!((&target["asked"], &target["unit"]), (&"60kB".into(), &"bytes".into()));
    let size = bytes(at.join("run/scene.safetensors")).len() as f64;
    assert!(target["got"] == size && size <= target["expected"].as_f64().unwrap() && size <= 6e4, "{target}");
    assert!(ok(at, &["train", "--out=run", "--resume"]).contains("60kB: "));

    assert!(fails(at, 2, &["train", "--target=1 GB fps"]).contains("kB, MB or GB"));
    assert!(fails(at, 2, &["train", "--target=0MB"]).contains("positive"));
    assert!(fails(at, 2, &["train", "--target=9MB", "--budget=500"]).contains("--budget"));
    assert!(fails(at, 2, &["train", "--target=5min", "--steps=50"]).contains("--steps"));
    assert!(fails(at, 2, &["train", "--target=9MB", "--resume"]).contains("cannot be used with"));
    let message = fails(at, 1, &[&["train", "--out=no", "--target=5kB"], &without_budget[..]].concat());
    assert!(message.contains("fewer than 100 primitives") && !at.join("no").exists(), "{message}");
}

#[test]
fn rendering_presets_draw_less() {
    let folder = folder();
    let at = folder.path();
    train(at, "run", &["--quiet"]);
    for preset in ["quality", "fast"] {
        ok(at, &["render", "run", "--device=cpu", "--out", preset, "--preset", preset]);
    }
    ok(at, &["render", "run", "--device=cpu", "--out=plain"]);
    let names = png_names(&at.join("plain"));
    let equal =
        |preset: &str| names.iter().filter(|n| is_equal(at.join("plain").join(n), at.join(preset).join(n))).count();
    assert_eq!((names.len(), equal("quality")), (6, 6));
    assert!(equal("fast") < 6);
    assert!(fails(at, 2, &["render", "run", "--out=a", "--preset=cpu"]).contains("balanced"));
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

#[cfg(unix)]
#[test]
fn an_interrupted_run_resumes_to_the_same_scene() {
    let folder = folder();
    let at = folder.path();
    train(at, "whole", &[]);

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

    let mut child = start_training(at, "killed", &[]);
    wait_until(|| at.join("killed/checkpoint.safetensors").is_file());
    child.kill().unwrap();
    child.wait().unwrap();
    ok(at, &["train", "--out", "killed", "--resume"]);

    for run in ["stopped", "killed"] {
        assert!(is_equal(at.join("whole/scene.safetensors"), at.join(run).join("scene.safetensors")), "{run}");
        assert_eq!(metrics(&at.join("whole")), metrics(&at.join(run)), "{run}");
        let pictures = |run: &str| png_names(&at.join(run).join("pictures"));
        assert_eq!(pictures("whole"), pictures(run));
    }
}

#[test]
fn bench_step_measures_with_and_without_files() {
    let folder = folder();
    let small = ["--device=cpu", "--size=48x32", "--rounds=2", "--warm-up=0"];
    let made = [
        "bench",
        "step",
        "realistic",
        "--surfels=50",
        "--gaussians=200",
        "--json=step.json",
        "--save-scene=a.safetensors",
    ];
    let table = ok(folder.path(), &[&made[..], &small].concat());
    assert!(table.starts_with("joint step, 50 surfels, 200 Gaussians, 1 view of 48x32 px, on burn-ndarray"), "{table}");
    let found = json(folder.path().join("step.json"));
    assert!(
        found["hardware"] == "cpu" && found["gpu"].is_null() && found["not_measured"].as_array().unwrap().len() == 1
    );
    assert!(found["time"]["steps"] == 2 && found["time"]["median_ms"].as_f64().unwrap() > 0.0, "{found}");
    assert!(found["lists"]["gaussians"]["inside_pairs"].as_u64().unwrap() > 0, "{found}");
    assert_eq!((&found["camera"]["cx"], &found["camera"]["cy"]), (&json!(24.0), &json!(16.0)));

    let again = ["bench", "step", "a.safetensors", "--data=builtin", "--cameras=2", "--stage=blended"];
    let table = ok(folder.path(), &[&again[..], &small].concat());
    assert!(table.starts_with("mcmc step, 0 surfels, 200 Gaussians, 2 views of 48x32 px"), "{table}");

    let without = ["bench", "step", "realistic", "--surfels=0", "--gaussians=0", "--device=cpu"];
    assert!(fails(folder.path(), 2, &without).contains("nothing to train"));
    let wrong = fails(folder.path(), 2, &["bench", "step", "realistic", "--stage=mixed"]);
    assert!(wrong.contains("mixed") && wrong.contains("joint (surfels and Gaussians)"), "{wrong}");
}
