//! Studies over several runs.

use dpges_train::metrics::lpips::Network;
use serde_json::{Value, json};

use super::measures::write_network;
use super::{bytes, dpges, fails, folder, is_equal, json, ok};
#[cfg(unix)]
use super::{start, wait_until};

#[test]
fn a_series_begins_with_no_run_if_one_cannot_be_trained() {
    let folder = folder();
    let at = folder.path();
    let lens = ["builtin:lens=fisheye", "--set=data.undistort=false"];
    let compare = ["compare", "--out=study", "--device=cpu", "--steps=5", "--max-resolution=32"];
    let message = fails(at, 1, &[&compare[..], &["--methods=dpges,2dgs"], &lens].concat());
    for part in ["2dgs: discs cannot be seen through a lens", "data.undistort", "leave it out"] {
        assert!(message.contains(part), "{part}: {message}");
    }
    assert!(!at.join("study/dpges").exists(), "nothing is trained for nothing");
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
    write_network(&at.join("alex.safetensors"), Network::Alex);
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
