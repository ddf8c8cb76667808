//! Measures that are taken when they are asked for.

use std::path::Path;

use dpges_train::metrics::lpips::Network;
use safetensors::Dtype;
use safetensors::tensor::TensorView;
use serde_json::Value;

use super::{assert_contains, data_folder, fails, folder, json, ok, png_names, said, trained};

/// A file for `--lpips` with arbitrary weights.
pub fn write_network(path: &Path, network: Network) {
    let value = |i: usize| (i * 37 % 101) as f32 / 1000.0;
    let tensors: Vec<(String, Vec<usize>, Vec<u8>)> = network
        .tensors()
        .into_iter()
        .map(|tensor| {
            let bytes = (0..tensor.shape.iter().product()).flat_map(|i| value(i).to_le_bytes()).collect();
            (tensor.name, tensor.shape, bytes)
        })
        .collect();
    let views = tensors
        .iter()
        .map(|(name, shape, bytes)| (name.as_str(), TensorView::new(Dtype::F32, shape.clone(), bytes).unwrap()));
    let metadata =
        [("network", network.name()), ("version", "0.1")].map(|(key, value)| (key.to_owned(), value.to_owned()));
    safetensors::serialize_to_file(views, Some(metadata.into()), path).unwrap();
}

#[test]
fn popping_and_frame_times_are_measured_when_asked_for() {
    let at = &folder();
    trained(at, "run");
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
            assert_eq!([&times["width"], &times["height"]], [32, 32]);
            assert_eq!(times["renderer"], "raster");
            assert!(table.contains(times["device"].as_str().unwrap()), "{table}");
        }
        None => assert!(table.contains("not measured: ") && table.contains("adapter"), "{table}"),
    }
}

#[test]
fn lpips_is_measured_with_a_network_and_worst_views_are_shown() {
    let at = &folder();
    trained(at, "run");
    write_network(&at.join("alex.safetensors"), Network::Alex);
    let eval = ["eval", "run", "--device=cpu"];
    assert_contains(&said(at, &eval), &["LPIPS", "tools/lpips_weights.py", "SSIMULACRA2"]);

    let more = ["--lpips=alex.safetensors", "--worst=worst", "--json=result.json"];
    let table = ok(at, &[&eval[..], &more].concat());
    assert_contains(&table, &["LPIPS (Alex)", "SSIMULACRA2", "worst", "worst/worst_psnr.png"]);
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
    assert!(broken.contains("vgg.safetensors") && broken.contains("docs/guide/measure.md"), "{broken}");
    let scene = fails(at, 1, &[&eval[..], &["--lpips=run/scene.safetensors"]].concat());
    assert!(scene.contains("run/scene.safetensors") && scene.contains("`network`"), "{scene}");
}

#[test]
fn networks_in_the_data_folder_are_found_without_being_named() {
    let at = &folder();
    let networks = data_folder(at).join("dpges/lpips");
    std::fs::create_dir_all(&networks).unwrap();
    trained(at, "run");
    write_network(&networks.join("alex.safetensors"), Network::Alex);
    let eval = |more: &[&str]| ok(at, &[&["eval", "run", "--device=cpu", "--json=result.json"], more].concat());
    let fails_to_eval = |more: &str| fails(at, 1, &["eval", "run", "--device=cpu", more]);
    assert!(eval(&[]).contains("not measured"), "AlexNet alone is measured when it is asked for");
    assert!(eval(&["--lpips=alex"]).contains("LPIPS (Alex)"));
    let absent = fails_to_eval("--lpips=vgg");
    assert_contains(&absent, &["there is no", "dpges/lpips/vgg.safetensors", "tools/lpips_weights.py vgg"]);

    write_network(&networks.join("vgg.safetensors"), Network::Vgg);
    let found = eval(&[]);
    assert!(found.contains("LPIPS (VGG)"), "{found}");
    assert!(!found.contains("LPIPS (Alex)") && !found.contains("not measured"), "{found}");
    assert!(json(at.join("result.json"))["lpips_vgg"].as_f64().unwrap() > 0.0);
    let none = eval(&["--lpips=none"]);
    assert!(!none.contains("LPIPS"), "{none}");
    assert!(fails(at, 2, &["eval", "run", "--device=cpu", "--lpips=none", "--lpips=alex"]).contains("`none`"));
    std::fs::write(networks.join("vgg.safetensors"), "no tensors").unwrap();
    let broken = fails_to_eval("--fit-exposure");
    assert_contains(&broken, &["dpges/lpips/vgg.safetensors", "tools/lpips_weights.py"]);
}

#[test]
fn bench_step_measures_made_and_trained_scenes() {
    let at = &folder();
    let small = ["--device=cpu", "--size=48x32", "--rounds=2", "--warm-up=0"];
    let made = ["bench", "step", "realistic", "--surfels=50", "--gaussians=200", "--json=step.json"];
    let table = ok(at, &[&made[..], &small].concat());
    assert_contains(&table, &["burn-flex", "joint, 50 surfels, 200 Gaussians, 1 x 48x32 px", "median"]);
    let found = json(at.join("step.json"));
    assert_eq!((&found["emulated"], &found["gpu"]), (&false.into(), &Value::Null));
    assert!(found["steps"] == 2 && found["median_ms"].as_f64().unwrap() > 0.0, "{found}");
    assert!(found["transfers"]["uploads"].as_u64().unwrap() > 0, "{found}");

    trained(at, "run");
    let again = ["bench", "step", "run", "--cameras=2", "--stage=blended"];
    let table = ok(at, &[&again[..], &small].concat());
    assert!(table.contains("mcmc, 0 surfels") && table.contains("2 x 48x32 px"), "{table}");

    let without = ["bench", "step", "realistic", "--surfels=0", "--gaussians=0", "--device=cpu"];
    assert!(fails(at, 2, &without).contains("nothing to train"));
    let wrong = fails(at, 2, &["bench", "step", "realistic", "--stage=mixed"]);
    assert!(wrong.contains("mixed") && wrong.contains("joint (surfels and Gaussians)"), "{wrong}");
}
