//! Runs, from their first step or the one they were stopped after.

use serde_json::Value;

use super::{
    TINY, assert_contains, both, bytes, content, fails, folder, is_equal, json, json_of, metrics, ok, png_names, train,
    trained,
};

#[test]
fn a_run_writes_everything_and_can_be_measured_and_shown() {
    let at = &folder();
    let table = train(at, "run", &[]);
    let run = at.join("run");
    assert_contains(&table, &["60 steps", "held-out PSNR", "surfels", "run/scene.safetensors"]);
    let config = content(run.join("config.toml"));
    assert!(config.contains("steps = 60") && config.contains("budget = 1500"), "{config}");
    assert_eq!(json(run.join("run.json"))["dataset"], "builtin");

    let lines = metrics(&run);
    let steps = |kind: &str| -> Vec<u64> {
        let of_kind = lines.iter().filter(|line| line["kind"] == kind);
        of_kind.map(|line| line["step"].as_u64().unwrap()).collect()
    };
    // the stage of Gaussians ends after 12
    assert_eq!(steps("evaluation"), [12, 25, 50, 60]);
    assert!([10, 20, 30, 40, 50, 60].iter().all(|step| steps("step").contains(step)));
    assert!(lines.iter().any(|line| line.contains_key("events")), "refinement is logged");
    assert_eq!(png_names(&run.join("pictures")).len(), 4 * 3);

    let written = json(run.join("eval.json"));
    let size = bytes(run.join("scene.safetensors")).len() as u64;
    assert_eq!((written["bytes"].as_u64(), written["split"].as_str()), (Some(size), Some("test")));
    let mut measured = json_of(at, &["eval", "run", "--save-images", "views", "--device=cpu"]);
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
    assert_eq!(json_of(at, &small)["psnr"], written["psnr"]);

    ok(at, &["render", "run", "--out", "layers", "--layers"]);
    let names = png_names(&at.join("layers"));
    assert_eq!(names.len(), 6 * 9);
    for part in ["", "_surfels", "_depth", "_normal", "_transmittance_1", "_transmittance_5"] {
        assert!(names.contains(&format!("test_000{part}.png")), "{part}: {names:?}");
    }
    let ranges = json(at.join("layers/layers.json"));
    assert!(ranges[0]["depth_near"].as_f64().unwrap() < ranges[0]["depth_far"].as_f64().unwrap());

    assert!(ok(at, &["info", "run"]).contains("colour_model"));
    let lobes = 2 * (written["surfels"].as_u64().unwrap() + written["gaussians"].as_u64().unwrap());
    let info = json_of(at, &["info", "run", "--json"]);
    assert_eq!((&info["surfels"], &info["bytes"]), (&written["surfels"], &written["bytes"]));
    assert_eq!(info["lobes"].as_array().unwrap().iter().map(|n| n.as_u64().unwrap()).sum::<u64>(), lobes);
}

#[test]
fn equal_seeds_give_equal_files_and_a_run_is_not_overwritten_by_accident() {
    let at = &folder();
    trained(at, "a");
    assert!(train(at, "b", &["--quiet"]).is_empty());
    assert!(is_equal(at.join("a/scene.safetensors"), at.join("b/scene.safetensors")));
    assert!(is_equal(at.join("a/checkpoint.safetensors"), at.join("b/checkpoint.safetensors")));
    let message = fails(at, 1, &["train", "--out", "a"]);
    assert!(message.contains("--overwrite") && message.contains("--resume"), "{message}");
    train(at, "a", &["--seed=4", "--overwrite"]);
    assert!(!is_equal(at.join("a/scene.safetensors"), at.join("b/scene.safetensors")));
}

#[test]
fn a_finished_run_resumes_to_itself_and_contradictions_are_refused() {
    let at = &folder();
    trained(at, "run");
    std::fs::copy(at.join("run/scene.safetensors"), at.join("before.safetensors")).unwrap();
    let lines = metrics(&at.join("run"));
    assert!(ok(at, &["train", "--out", "run", "--resume"]).contains("held-out PSNR"));
    assert!(is_equal(at.join("run/scene.safetensors"), at.join("before.safetensors")));
    assert_eq!(metrics(&at.join("run")), lines);
    let message = fails(at, 1, &["train", "--out", "run", "--resume", "--steps", "50"]);
    assert!(message.contains("60 of 60 steps are done") && message.contains("only be made longer"), "{message}");
    assert!(fails(at, 2, &["train", "--out", "run", "--resume", "--preset", "cpu"]).contains("`init.max_points`"));
    std::fs::write(at.join("run/checkpoint.safetensors"), "half").unwrap();
    assert!(fails(at, 1, &["train", "--out", "run", "--resume"]).contains("checkpoint.safetensors"));
}

#[test]
fn a_finished_run_is_made_longer() {
    let at = &folder();
    trained(at, "run");
    let (table, said) = both(at, &["train", "--out", "run", "--resume", "--steps", "70"]);
    assert_contains(&said, &["goes on from step 60", "a run of 70 steps", "learning rates rise again"]);
    assert!(table.contains("70 steps"), "{table}");
    assert_eq!(metrics(&at.join("run")).last().unwrap()["step"], 70);
    assert!(content(at.join("run/config.toml")).contains("steps = 70"));
    ok(at, &["train", "--out", "run", "--resume", "--steps", "75", "--quiet"]);
    assert_eq!(metrics(&at.join("run")).last().unwrap()["step"], 75);
    assert!(at.join("run/eval.json").is_file());
}

#[test]
fn a_step_that_is_not_finite_ends_the_run() {
    let at = &folder();
    let broken =
        [&["train", "--out", "run", "--set=train.lambda_surfel=1e39", "--set=stages.gaussians=0"], &TINY[..]].concat();
    let message = fails(at, 1, &broken);
    assert!(message.contains("step 1, view `train_") && message.contains("the loss is inf"), "{message}");
    assert!(message.contains("there was no checkpoint yet: train.checkpoint_every"), "{message}");
}
