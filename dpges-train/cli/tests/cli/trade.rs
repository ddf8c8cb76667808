//! Less quality for more speed and smaller files.

use dpges_train::metrics::lpips::Network;
use serde_json::{Value, json};

use super::measures::write_network;
use super::{
    TINY, assert_contains, bytes, content, fails, folder, is_equal, json, json_of, ok, png_names, trained, words,
};

#[test]
fn a_compressed_scene_is_smaller_and_read_like_any_other() {
    let at = &folder();
    trained(at, "run");
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
    compress(&["--out", "again", "--split", "train", "--json", "again.json"]);
    assert!(is_equal(at.join("medium"), at.join("again")));

    let [before, after] = ["run", "medium"].map(|scene| json_of(at, &["info", scene, "--json"]));
    for key in ["surfels", "gaussians", "colour_model", "lobes", "rendering", "background", "extent"] {
        assert_eq!(before[key], after[key], "{key}");
    }
    let measured = json_of(at, &["eval", "medium", "--data=builtin", "--max-resolution=32", "--device=cpu"]);
    assert!((number(&measured, "psnr") - number(&medium, "psnr_after")).abs() < 1e-6);

    compress(&["--out", "low", "--quality", "low", "--json", "low.json"]);
    let low = report("low.json");
    let [small, large] = [&low, &medium].map(|report| number(report, "bytes_after") as usize);
    assert!(small < large);
    let between = (small + large) / 2;
    compress(&["--out", "between", "--budget", &format!("{}MB", between as f64 / 1e6)]);
    assert!((small..=between).contains(&bytes(at.join("between")).len()));
    let message = fails(at, 1, &["compress", "run", "--device=cpu", "--out", "tiny", "--budget", "0.001MB"]);
    assert!(message.contains(&small.to_string()) && message.contains("--budget"), "{message}");

    // held-out views do not decide
    let allowed = loss(&report("again.json")).max(0.05);
    let table = compress(&["--out", "close", "--target", &format!("{allowed}dB"), "--json", "close.json"]);
    assert!(table.contains("split `train`"), "{table}");
    let close = report("close.json");
    assert!(loss(&close) <= allowed && number(&close, "bytes_after") <= number(&medium, "bytes_after"), "{close}");

    std::fs::copy(at.join("run/scene.safetensors"), at.join("alone.safetensors")).unwrap();
    let table = ok(at, &["compress", "alone.safetensors", "--out", "alone"]);
    assert!(table.contains("not measured") && is_equal(at.join("alone"), at.join("medium")), "{table}");
    let refused = |args: &[&str]| fails(at, 2, &[&["compress", "alone.safetensors"], args].concat());
    assert!(refused(&["--out", "no", "--target", "0.1dB"]).contains("--data"));
    assert!(refused(&["--out", "no", "--target", "1MB"]).contains("--budget 1MB"));
    assert!(refused(&["--out", "no", "--budget", "1MB", "--quality", "low"]).contains("cannot be used with"));
    assert!(refused(&["--out", "alone.safetensors"]).contains("--out is the scene itself"));
    assert!(!at.join("no").exists() && !at.join("tiny").exists());
}

#[test]
fn the_trade_of_speed_and_quality_is_measured_once() {
    let at = &folder();
    trained(at, "run");
    write_network(&at.join("alex.safetensors"), Network::Alex);
    let args = words(
        "trade run --lpips=alex.safetensors --out=trade --device=cpu --renderer=training --size=24x16 \
                --views=2 --rounds=1 --only=detail,primitives,budget",
    );
    let table = ok(at, &args);
    assert_contains(
        &table,
        &["as trained", "LPIPS (Alex)", "trade.csv", "trade_frame_time.svg", "trade_bytes.png", "report.html"],
    );
    let trade = || json(at.join("trade/trade.json"));
    let points = || trade()["rows"].as_array().unwrap().clone();
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
    for key in ["psnr", "ssim", "flip", "lpips_alex", "frame_ms", "frame_p99_ms"] {
        assert!(whole[key].as_f64().unwrap() > 0.0, "{key}: {whole}");
    }
    assert!(trade()["device"].as_str().unwrap().contains("by the renderer that is trained with"), "{whole}");
    let frontiers = &trade()["frontiers"];
    assert!(!frontiers["bytes"].as_array().unwrap().is_empty() && frontiers["training_seconds"].is_null());
    let csv = content(at.join("trade/trade.csv"));
    assert_eq!(csv.lines().count(), 1 + points().len());
    let plot = image::open(at.join("trade/trade_bytes.png")).unwrap();
    assert_eq!((plot.width(), plot.height()), (1100, 620));
    assert!(!at.join("trade/trade_training_time.svg").exists());
    let page = content(at.join("trade/report.html"));
    assert!(page.contains("data:image/jpeg;base64,") && page.contains("<svg ") && !page.contains("src=\"http"));

    // again: nothing is measured; then one point that is missing
    let before = points();
    assert_eq!(ok(at, &args), table);
    assert_eq!(points(), before);
    let mut without = trade();
    without["rows"].as_array_mut().unwrap().remove(1);
    std::fs::write(at.join("trade/trade.json"), without.to_string()).unwrap();
    ok(at, &args);
    assert!(points().iter().any(|point| point["label"] == "detail=1"));
    assert!(before.iter().filter(|point| point["label"] != "detail=1").all(|point| points().contains(point)));

    let message = fails(at, 1, &[&args[..], &["--size=25x16"]].concat());
    assert!(message.contains("trade/trade.json holds other measurements: `frame_size` is [24,16], not [25,16]"));
    let message = fails(at, 1, &[&args[..], &["--split=test"]].concat());
    assert!(message.contains("`split` is \"train\", not \"test\""), "{message}");

    // training: first without any time, then with enough
    let trained = [&args[..], &["--train", "--set=train.steps=6", "--set=train.evaluate_every=0"]].concat();
    let left = ok(at, &[&trained[..], &["--time-limit=0.001s"]].concat());
    assert!(left.contains("the same command goes on: ") && left.contains("budget-half, seed 3"), "{left}");
    ok(at, &trained);
    let of_training: Vec<Value> = points().into_iter().filter(|point| point["seed"].is_u64()).collect();
    let expected = ["trained-again", "budget-half", "budget-quarter", "detail-1", "detail-0"];
    assert_eq!(of_training.iter().map(|point| point["label"].clone()).collect::<Vec<_>>(), expected.map(Value::from));
    assert_eq!(trade()["not_run"], json!([]));
    for point in &of_training {
        assert!(point["training_seconds"].as_f64().unwrap() > 0.0 && point["seed"] == 3, "{point}");
        assert_eq!(point["training_peak_bytes"].is_u64(), cfg!(target_os = "linux"), "{point}");
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
    let at = &folder();
    let without_steps: Vec<&str> = TINY.into_iter().filter(|option| !option.starts_with("--steps")).collect();
    let table = ok(at, &[&["train", "--out=run", "--target=10s"], &without_steps[..]].concat());
    assert!(table.contains("10s: ") && table.contains(" s expected"), "{table}");
    let target = json(at.join("run/eval.json"))["target"].clone();
    assert_eq!((&target["asked"], &target["unit"]), (&"10s".into(), &"seconds".into()));
    assert!(target["got"].as_f64().unwrap() > 0.0 && target["expected"].as_f64().unwrap() <= 10.0, "{target}");
    assert!(ok(at, &["train", "--out=run", "--resume"]).contains("10s: "));

    for (options, part) in [
        (&["--target=60kB"][..], "--budget 0.06MB"),
        (&["--target=1 GB fps"], "s, min or h"),
        (&["--target=0fps"], "positive"),
        (&["--target=30fps", "--budget=500"], "--budget"),
        (&["--target=5min", "--steps=50"], "--steps"),
        (&["--target=9s", "--resume"], "cannot be used with"),
    ] {
        assert_contains(&fails(at, 2, &[&["train"], options].concat()), &[part]);
    }
    let message = fails(at, 1, &[&["train", "--out=no", "--target=0.01s"], &without_steps[..]].concat());
    assert!(message.contains("too short") && !at.join("no").exists(), "{message}");
}

#[test]
fn rendering_presets_draw_less() {
    let at = &folder();
    trained(at, "run");
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
