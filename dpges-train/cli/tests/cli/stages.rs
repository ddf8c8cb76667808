//! Results of stages, and decisions about their lengths and budgets.

use serde_json::Value;

use super::{assert_contains, bytes, fails, folder, is_equal, json, json_of, metrics, ok, png_names, said, train};

#[test]
fn what_a_method_trains_alone_can_be_a_beginning() {
    let at = &folder();
    let short = ["--steps=20", "--set=train.evaluate_every=0"];
    train(at, "discs", &[&short[..], &["--method=2dgs"]].concat());
    train(at, "gaussians", &[&short[..], &["--method=mcmc"]].concat());
    let rendering = |run: &str| -> Value { json_of(at, &["info", run, "--json"])["rendering"].clone() };
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
    for (method, option, instead) in
        [("2dgs", "gaussians", "surfels"), ("mcmc", "surfels", "gaussians"), ("sortfree", "gaussians", "")]
    {
        let file = format!("--init-{option}=both/scene.safetensors");
        let message = fails(at, 1, &["train", "--out=no", "--max-resolution=32", "--method", method, &file]);
        assert_contains(&message, &[&format!("--init-{option} does not go with this method"), instead]);
    }
    assert!(!at.join("no").exists());
    // what was peeled is sorted from its first step on, and splats of a file are a beginning too
    ok(at, &["export", "gaussians", "--format=ply", "--fit=0", "--out=splats.ply", "--device=cpu"]);
    let itself = fails(at, 2, &["export", "splats.ply", "--format=ply", "--fit=0", "--out=splats.ply", "--device=cpu"]);
    assert_contains(&itself, &["splats.ply", "another file"]);
    for (run, method, from) in [
        ("sorted", "3dgs", "both/scene.safetensors"),
        ("again", "mcmc", "splats.ply"),
        ("joint", "dpges", "splats.ply"),
    ] {
        let from = format!("--init-gaussians={from}");
        train(at, run, &[&short[..], &["--method", method, &from, "--steps=1"]].concat());
        let [begun, given] = [run, if run == "sorted" { "both" } else { "gaussians" }]
            .map(|run| json(at.join(run).join("eval.json"))["psnr"].as_f64().unwrap());
        assert!(begun > given - 2.5, "{run} begins at {begun} dB, its file has {given}");
    }
}

#[test]
fn what_sorts_by_centres_says_so_of_a_scene_that_is_sorted_along_rays() {
    let at = &folder();
    let short = ["--steps=20", "--set=train.evaluate_every=0"];
    train(at, "rays", &[&short[..], &["--method=stopthepop"]].concat());
    let info = json_of(at, &["info", "rays", "--json"]);
    assert_eq!((&info["blend_order"], &info["screen_filter"]), (&"rays".into(), &"plain".into()));
    let refused = fails(at, 1, &["bench", "render", "rays"]);
    assert!(refused.contains("StopThePop") && refused.contains("--training DEVICE"), "{refused}");
    let measured = ["bench", "render", "rays", "--training=cpu", "--size=32x32", "--rounds=1", "--cameras=1"];
    let table = ok(at, &measured);
    assert!(table.contains("training") && !table.contains("raster"), "{table}");
    let export = ["export", "rays", "--format=ply", "--out=splats.ply", "--device=cpu"];
    assert_contains(&said(at, &export), &["sorts the Gaussians by their centres"]);
    assert!(!said(at, &["render", "rays", "--out=pictures", "--device=cpu"]).contains("by their centres"));
}

#[test]
fn what_the_real_time_renderer_does_not_draw_is_measured_by_the_renderer_of_training() {
    let at = &folder();
    // kernels of `sss` start too small to be seen
    let short = ["--steps=20", "--set=train.evaluate_every=0", "--set=optimizer.log_scales=0.1"];
    for (method, rendering, named) in
        [("sss", "students", "Student's t"), ("sortfree", "summed", "sort-free Gaussians")]
    {
        train(at, method, &[&short[..], &["--method", method]].concat());
        assert_eq!(json_of(at, &["info", method, "--json"])["rendering"], rendering);
        let splats = ["export", method, "--format=ply", "--out=splats.ply", "--device=cpu"];
        for refused in [&["bench", "render", method][..], &splats] {
            assert_contains(&fails(at, 1, refused), &[named]);
        }
        let measured = ["bench", "render", method, "--training=cpu", "--size=32x32", "--rounds=1", "--cameras=1"];
        let table = ok(at, &measured);
        assert!(table.contains("training") && !table.contains("raster"), "{table}");
        let table = ok(at, &["eval", method, "--device=cpu", "--popping", "--frame-times", "--json=result.json"]);
        assert!(table.contains("by `training` on cpu"), "{table}");
        let result = json(at.join("result.json"));
        assert_eq!((&result["frame_ms"]["renderer"], &result["popping"]["frames"]), (&"training".into(), &60.into()));
        ok(at, &["render", method, "--out", &format!("{method}_pictures"), "--device=cpu"]);
        assert_eq!(png_names(&at.join(format!("{method}_pictures"))).len(), 6);
    }
}

#[test]
fn stages_leave_their_scenes() {
    let at = &folder();
    let stages = ["--set=stages.surfels=0.3", "--set=stages.gaussians=0.3", "--set=stages.surfel_opacity=0.1"];
    train(at, "whole", &stages);
    for stage in ["2dgs", "mcmc"] {
        let report = json(at.join(format!("whole/stage_{stage}.json")));
        assert!(report["psnr"].as_f64().unwrap() > 5.0, "{report}");
        ok(at, &["eval", &format!("whole/stage_{stage}.safetensors"), "--data", "builtin", "--max-resolution=32"]);
    }
    let named: Vec<Value> = metrics(&at.join("whole")).iter().filter_map(|line| line.get("stage").cloned()).collect();
    for stage in ["2dgs", "mcmc", "joint"] {
        assert!(named.contains(&stage.into()), "{named:?}");
    }
}

#[test]
fn validation_views_end_a_run_with_the_best_scene() {
    let at = &folder();
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
    let at = &folder();
    train(at, "auto", &["--budget=auto", "--steps=100"]);
    let events: Vec<String> = metrics(&at.join("auto"))
        .iter()
        .filter_map(|line| line.get("events")?.as_array().cloned())
        .flatten()
        .map(|event| event.as_str().unwrap().to_owned())
        .collect();
    let told = ["layers instead of 5", "% of the covered pixels", "lobes", "dB, the best so far: growth to "];
    for part in told {
        assert!(events.iter().any(|event| event.contains(part)), "{part}: {events:?}");
    }
    train(at, "size", &["--budget=0.1MB"]);
    assert!(bytes(at.join("size/scene.safetensors")).len() < 105_000);
    assert!(fails(at, 2, &["train", "--budget=12GB"]).contains("12.5MB"));
}
