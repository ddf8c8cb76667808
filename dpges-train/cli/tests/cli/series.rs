//! Studies over several runs.

use dpges_train::metrics::lpips::Network;
use serde_json::Value;

use super::measures::write_network;
use super::{assert_contains, bytes, content, fails, folder, json, ok, said, words};

/// The cells of a table, line by line.
fn cells(csv: &str) -> Vec<Vec<&str>> {
    csv.lines().map(|line| line.split(',').collect()).collect()
}

/// In the column whose head is `name`.
fn value<'a>(lines: &[Vec<&'a str>], line: usize, name: &str) -> &'a str {
    lines[line][lines[0].iter().position(|column| *column == name).unwrap()]
}

#[test]
fn a_series_begins_with_no_run_if_one_cannot_be_trained() {
    let at = &folder();
    let lens = ["builtin:lens=fisheye", "--set=data.undistort=false"];
    let compare = ["compare", "--out=study", "--device=cpu", "--steps=5", "--max-resolution=32"];
    let message = fails(at, 1, &[&compare[..], &["--methods=dpges,2dgs"], &lens].concat());
    assert_contains(&message, &["2dgs: discs cannot be seen through a lens", "data.undistort", "leave it out"]);
    assert!(!at.join("study/dpges").exists(), "nothing is trained for nothing");
}

#[test]
fn variants_are_trained_once_and_compared() {
    let at = &folder();
    let args = words(
        "ablate --out=study --device=cpu --steps=6 --seed=3 --max-resolution=32 --budget=900 \
                --only=sh,full",
    );
    let table = ok(at, &args);
    assert_contains(
        &table,
        &["| full", "| sh", "PSNR, dB", "to full", "Gaussians", "ablation.csv", "ablation_bytes.svg", "report.html"],
    );
    let csv = content(at.join("study/ablation.csv"));
    let lines = cells(&csv);
    let number = |lines: &[Vec<&str>], line: usize, name: &str| value(lines, line, name).parse::<f64>().unwrap();
    assert_eq!((lines[0][0], lines[1][0], lines[2][0], lines.len()), ("variant", "full", "sh", 3));
    for (index, line) in lines.iter().enumerate().skip(1) {
        let run = at.join("study").join(line[0]).join("seed_3");
        let written = json(run.join("eval.json"));
        assert!((number(&lines, index, "psnr") - written["psnr"].as_f64().unwrap()).abs() < 1e-4, "{csv}");
        assert_eq!(number(&lines, index, "bytes"), bytes(run.join("scene.safetensors")).len() as f64);
        let config = content(run.join("config.toml"));
        assert_eq!(config.contains("colour = \"sh3\""), line[0] == "sh", "{config}");
        assert!(config.contains("\nsteps = 6\n") && config.contains("\nseed = 3\n"), "{config}");
    }
    let plot = content(at.join("study/ablation_bytes.svg"));
    assert!(plot.starts_with("<svg ") && plot.contains("full"), "{plot}");
    let page = content(at.join("study/report.html"));
    assert!(page.contains("data:image/jpeg;base64,") && page.contains("<svg ") && !page.contains("src=\"http"));

    // finished, finished but for its evaluation
    let [full, sh] = ["full", "sh"].map(|variant| at.join("study").join(variant).join("seed_3"));
    let (log, scene) = (bytes(full.join("metrics.jsonl")), bytes(sh.join("scene.safetensors")));
    std::fs::remove_file(sh.join("eval.json")).unwrap();
    ok(at, &args);
    assert!(bytes(full.join("metrics.jsonl")) == log, "it is not trained again");
    assert!(bytes(sh.join("scene.safetensors")) == scene && sh.join("eval.json").is_file());
    // the last column is the memory of the process that wrote the evaluation
    let without_memory =
        |csv: &str| csv.lines().map(|line| line.rsplit_once(',').unwrap().0.to_owned()).collect::<Vec<_>>();
    let again = content(at.join("study/ablation.csv"));
    assert_eq!(without_memory(&again), without_memory(&csv));

    // a second seed
    let table = ok(at, &[&args[..], &["--seeds=2"]].concat());
    assert!(table.contains(" ± ") && table.contains("over seeds 3, 4"), "{table}");
    assert!(bytes(full.join("metrics.jsonl")) == log, "the first is not trained again");
    let second =
        |variant: &str| json(at.join("study").join(variant).join("seed_4/eval.json"))["psnr"].as_f64().unwrap();
    let csv = content(at.join("study/ablation.csv"));
    let of_both = cells(&csv);
    let mean = (number(&lines, 2, "psnr") + second("sh")) / 2.0;
    let difference = mean - (number(&lines, 1, "psnr") + second("full")) / 2.0;
    for (name, expected) in [("psnr", mean), ("psnr_difference", difference)] {
        assert!((number(&of_both, 2, name) - expected).abs() < 2e-4, "{name}: {csv}");
    }
    assert!(number(&of_both, 2, "psnr_deviation") > 0.0, "{csv}");

    let message = fails(at, 1, &[&args[..], &["--budget=901"]].concat());
    assert!(message.contains("study/full/seed_3 holds another run") && message.contains("`refine.budget` is 900"));
    assert!(ok(at, &["info", "study/sh/seed_3"]).contains("peeling"));
}

#[test]
fn methods_are_trained_once_and_compared() {
    let at = &folder();
    let args = words(
        "compare builtin --out=study --device=cpu --methods=mcmc,dpges --seeds=2 --seed=3 --steps=12 \
                --max-resolution=32 --budget=700 --set=data.validation_every=4 --set=train.evaluate_every=0 --set=train.checkpoint_every=4 --set=init.max_points=300",
    );
    let table = ok(at, &args);
    assert_contains(
        &table,
        &["| mcmc", "| dpges", " ± ", "to mcmc", "validation PSNR", "at most 700 primitives", "comparison.csv"],
    );
    let comparison = json(at.join("study/comparison.json"));
    assert_eq!((&comparison["steps"], &comparison["budget"]), (&Value::from(12), &Value::from(700)));
    let csv = content(at.join("study/comparison.csv"));
    let lines = cells(&csv);
    let rows = |comparison: &Value| comparison["rows"].as_array().unwrap().clone();
    let cells: Vec<_> = rows(&comparison).iter().map(|row| (row["label"].clone(), row["seed"].clone())).collect();
    let expected = [("mcmc", 3), ("dpges", 3), ("mcmc", 4), ("dpges", 4)];
    assert_eq!(cells, expected.map(|(label, seed)| (Value::from(label), Value::from(seed))));
    for (line, name) in (1..).zip(["mcmc", "dpges"]) {
        let value = |key: &str| value(&lines, line, key);
        assert_eq!((lines[line][0], value("seeds")), (name, "2"));
        assert!(value("settings").starts_with(&format!("train.method={name}")), "{csv}");
        let of_method: Vec<Value> = rows(&comparison).into_iter().filter(|row| row["label"] == name).collect();
        let psnr: Vec<f64> = of_method.iter().map(|row| row["psnr"].as_f64().unwrap()).collect();
        let number = |key: &str| value(key).parse::<f64>().unwrap();
        assert!((number("psnr") - (psnr[0] + psnr[1]) / 2.0).abs() < 1e-4, "{csv}");
        let half = (psnr[0] - psnr[1]).abs() / 2f64.sqrt();
        assert!((number("psnr_deviation") - half).abs() < 1e-4 && half > 0.0, "{csv}");
        for row in of_method {
            let path = at.join("study").join(row["folder"].as_str().unwrap());
            let (test, kept) = (json(path.join("eval.json")), json(path.join("validation.json")));
            assert_eq!((&row["psnr"], &row["validation_psnr"]), (&test["psnr"], &kept["psnr"]));
            assert_eq!((&test["split"], &kept["split"]), (&"test".into(), &"validation".into()));
            assert!(kept["views"][0]["name"].as_str().unwrap().starts_with("train"), "{kept}");
            let config = content(path.join("config.toml"));
            assert!(config.contains("\nbudget = 700\n") && config.contains(&format!("\nseed = {}\n", row["seed"])));
        }
    }
    let figures = comparison["figures"].as_array().unwrap();
    assert_eq!(figures.len(), 3);
    for figure in figures {
        let picture = image::open(at.join("study").join(figure["file"].as_str().unwrap())).unwrap();
        assert_eq!((picture.width(), picture.height()), (3 * 32 + 2 * 2, 2 * 32 + 2), "{figure}");
    }
    let views = json(at.join("study/mcmc/seed_3/eval.json"))["views"].clone();
    let lowest = views.as_array().unwrap().iter().map(|view| view["psnr"].as_f64().unwrap()).fold(f64::MAX, f64::min);
    let caption = figures[0]["caption"].as_str().unwrap();
    assert_contains(caption, &[&format!("the worst of the first: photograph · mcmc {lowest:.2} dB · dpges ")]);
    let plot = content(at.join("study/comparison_training_time.svg"));
    assert!(plot.contains("mcmc") && plot.contains("dpges"), "{plot}");

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
    for row in rows(&with) {
        let written = json(run(row["folder"].as_str().unwrap()).join("eval.json"))["lpips_alex"].clone();
        assert!(row["lpips_alex"] == written && written.as_f64().unwrap() > 0.0, "{row}");
    }
    assert!(ok(at, &args).contains("LPIPS (Alex)"), "it stays in the files of the runs");

    let pops = [&args[..], &["--popping"]].concat();
    assert!(ok(at, &pops).contains("FLIP_7"));
    for method in ["mcmc", "dpges"] {
        let popping = json(run(method).join("seed_3/eval.json"))["popping"].clone();
        assert!(popping["flip_7"].as_f64().unwrap() > 0.0 && popping["frames"] == 60, "{popping}");
    }
    let again = said(at, &pops);
    assert!(!again.contains("measuring popping"), "{again}");
    assert!(ok(at, &args).contains("FLIP_7"), "it stays there too");

    let scene = bytes(run("mcmc/seed_3/scene.safetensors"));
    for file in ["eval.json", "validation.json"] {
        std::fs::remove_file(run("mcmc/seed_3").join(file)).unwrap();
    }
    std::fs::remove_dir_all(run("dpges/seed_3")).unwrap();
    let messages = said(at, &args);
    assert_contains(&messages, &["mcmc, seed 3: resumed", "mcmc, seed 4: already finished", "dpges, seed 3: 12 steps"]);
    let scores = |comparison: &Value| rows(comparison).iter().map(|row| row["psnr"].clone()).collect::<Vec<_>>();
    assert_eq!(scores(&comparison), scores(&json(at.join("study/comparison.json"))));
    assert!(bytes(run("mcmc/seed_3/scene.safetensors")) == scene);

    let message = fails(at, 1, &[&args[..], &["--steps=13"]].concat());
    assert!(message.contains("study/mcmc/seed_3 holds another run") && message.contains("`train.steps` is 12"));
}
