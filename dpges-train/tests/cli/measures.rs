//! Measures that are taken when they are asked for.

use std::path::Path;

use dpges_train::metrics::lpips::Network;
use safetensors::Dtype;
use safetensors::tensor::TensorView;
use serde_json::json;

use super::{dpges, fails, folder, json, ok, png_names, train};

/// A file for `--lpips` with arbitrary weights.
pub fn write_network(path: &Path) {
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
