//! Stages and methods: what they train and hand on, and what they need.

use std::sync::Arc;

use dpges_core::camera::CameraFromWorld;
use dpges_core::scene::{EnvironmentData, Rendering, SceneData};

use super::{STAGES, after, end_stage, gaussians, goes_on_alike, trainer};
use crate::config::{Config, StageKind};
use crate::dataset::{BuiltinOptions, builtin};
use crate::eval::evaluate;
use crate::run::Trainer;
use crate::run::fixtures::{config, dataset, device, options, step_until, trained};
use crate::views::corrections::ViewCorrections;
use crate::views::pose::PoseCorrection;
use crate::views::pose::gauge::Gauge;

#[test]
fn stages_hand_on_what_they_trained() {
    let mut trainer = trainer(&STAGES);
    let mut seen = Vec::new();
    let (mut events, mut terms) = (Vec::new(), Vec::new());
    while !trainer.is_finished() {
        let report = trainer.step().unwrap().unwrap();
        assert!(report.loss.is_finite() && report.psnr > 0.0, "{report:?}");
        assert!(report.terms.iter().all(|(_, value)| value.is_finite()), "{report:?}");
        terms = report.terms.iter().map(|&(name, _)| name).collect();
        events.extend(report.events);
        if trainer.stage_is_over() {
            seen.push((report.stage, trainer.completed_steps(), trainer.scene()));
        }
    }
    let order: Vec<(String, usize)> = seen.iter().map(|(stage, step, _)| (stage.to_string(), *step)).collect();
    assert_eq!(order, [("2dgs".to_owned(), 18), ("dbs".to_owned(), 36), ("joint".to_owned(), 60)]);
    let [(_, _, discs), (_, _, gaussians), (_, _, joint)] = &seen[..] else { unreachable!() };
    assert_eq!((discs.info.rendering, gaussians.info.rendering), (Rendering::Discs, Rendering::Ellipsoids));
    assert_eq!(joint.info.rendering, Rendering::Peeled);
    assert_eq!(terms[..6], ["rgb", "surfel", "scale", "transmittance", "opacity", "gaussian_scale"]);
    let opaque = discs.gaussians.opacities.iter().filter(|&&opacity| opacity > 0.12).count();
    assert!(opaque > 10 && joint.surfels.len() <= opaque, "{opaque}, {}", joint.surfels.len());
    assert!(discs.gaussians.len() <= 210 && gaussians.gaussians.len() <= 420);
    assert!(events.iter().any(|event| event.contains("discs added by densification")), "{events:?}");
}

#[test]
fn gaussians_are_held_down_unless_the_background_is_given() {
    let terms = |set: &[&str]| {
        let report = trainer(&[&["train.steps=4", "refine.budget=300"], set].concat()).step().unwrap().unwrap();
        report.terms.iter().any(|(name, _)| *name == "opacity")
    };
    assert!(terms(&[]) && terms(&["data.background=black", "model.environment=sh0"]));
    assert!(!terms(&["data.background=black"]));
    assert!(!terms(&["train.steps=600"]), "200 passes over the photographs");
}

#[test]
fn what_is_learnt_beside_the_primitives_learns_in_every_stage_and_goes_from_one_to_the_next() {
    let corrected = ["train.exposure=on", "train.poses=on", "optimizer.pose_from=0"];
    let mut trainer = trainer(&[&STAGES[..], &corrected].concat());
    let recorded = dataset();
    let cameras: Vec<CameraFromWorld> = recorded.train.iter().map(|view| view.camera.camera_from_world).collect();
    let gauge = Gauge::new(&cameras, recorded.extent);
    let neutral = EnvironmentData::neutral(1);
    assert_eq!(trainer.scene().environment.as_ref(), Some(&neutral));
    let mut before = [vec![0.0; 18], vec![0.0; 18], neutral.coefficients];
    for stage in ["2dgs", "dbs", "joint"] {
        assert_eq!(trainer.scene().environment.unwrap().coefficients, before[2], "{stage}");
        assert_eq!(end_stage(&mut trainer), stage);
        let checkpoint = trainer.checkpoint();
        let after = ["exposure", "poses", "environment"].map(|name| checkpoint.attributes[name].raw.clone());
        for (after, before) in after.iter().zip(&before) {
            assert!(after.len() == before.len() && after.iter().zip(before).all(|(a, b)| a != b), "{stage}: {after:?}");
        }
        let [exposures, poses, _] = &after;
        let ViewCorrections { exposure: Some(named), poses: Some(refined) } = trainer.view_corrections() else {
            panic!("photographs and cameras are corrected")
        };
        for keys in [named.keys().collect::<Vec<_>>(), refined.keys().collect()] {
            assert_eq!(keys, ["train_000", "train_001", "train_002"]);
        }
        // their means are 0
        for column in 0..6 {
            let sum: f32 = exposures.iter().skip(column).step_by(6).sum();
            assert!(sum.abs() < 1e-5, "{stage}: column {column} sums to {sum}");
        }
        assert!((named["train_001"].gain[0].ln() - f64::from(exposures[6])).abs() < 1e-6);
        // no part of them is a similarity of the whole world
        let rows = poses.as_chunks().0.iter();
        let common = gauge.common(&rows.map(PoseCorrection::of_row).collect::<Vec<_>>());
        let size = common.turn.length() + common.shift.length() + common.growth.abs();
        assert!(size < 1e-6, "{stage}: {common:?}");
        assert!((refined["train_001"].correction.rotation[2] - f64::from(poses[8])).abs() < 1e-9);
        for (now, recorded) in trainer.dataset().train.iter().zip(&recorded.train) {
            let expected = refined[&now.name].correction.applied(&recorded.camera.camera_from_world);
            assert!(now.camera.camera_from_world == expected && expected != recorded.camera.camera_from_world);
        }
        let changes = trainer.pose_changes().unwrap();
        assert!(changes.mean_degrees > 0.0 && changes.largest_shift < 0.1, "{changes}");
        before = after;
        if !trainer.is_in_last_stage() {
            trainer.next_stage().unwrap();
        }
    }
    let without = super::trainer(&["train.steps=9"]);
    assert!(!without.corrects_exposure() && without.view_corrections() == ViewCorrections::default());
    assert!(without.scene().environment.is_none() && !without.checkpoint().attributes.contains_key("poses"));
}

#[test]
fn coarse_stages_learn_from_half_of_the_photographs_and_hand_on_their_scene() {
    // as large as pictures must be for it, and as small as they can be
    let size = BuiltinOptions { width: 300, height: 5, ..options(5, [3, 1], 200) };
    let data = Arc::new(builtin(&size));
    let set = [
        "train.steps=30",
        "stages.gaussians=0.3",
        "stages.coarse=0.6",
        "refine.budget=400",
        "train.poses=on",
        "optimizer.pose_from=0",
    ];
    let begin = || Trainer::new(config(&set), Arc::clone(&data), device()).unwrap();
    let mut trainer = begin();
    for (stage, steps, width, most) in [("dbs", 9, 150, 240), ("coarse", 18, 150, 400), ("joint", 30, 300, 400)] {
        step_until(&mut trainer, Trainer::stage_is_over);
        assert_eq!((trainer.stage().to_string().as_str(), trainer.completed_steps()), (stage, steps));
        let views = trainer.dataset();
        assert_eq!((views.train[0].camera.width, views.test[0].camera.width), (width, 300), "{stage}");
        assert_eq!(views.train[0].picture().unwrap().width, width, "{stage}");
        let scene = trainer.scene();
        let count = scene.surfels.len() + scene.gaussians.len();
        assert!(count <= most && count > 0, "{stage}: {count}");
        if !trainer.is_in_last_stage() {
            trainer.next_stage().unwrap();
        }
        if stage == "coarse" {
            let mut begun = trainer.scene();
            begun.surfels.margins.clone_from(&scene.surfels.margins);
            assert_eq!((begun.surfels, begun.gaussians), (scene.surfels, scene.gaussians));
        }
    }
    goes_on_alike(begin, &data, &[5, 9, 14, 18, 24]);
}

#[test]
fn only_linear_opacities_become_odds() {
    let first_joint = |opacity: &str| {
        let set = ["train.steps=40", "stages.gaussians=0.5", "refine.budget=300", opacity];
        let mut trainer = trainer(&set);
        step_until(&mut trainer, |trainer| trainer.stage().kind == StageKind::Joint);
        gaussians(&mut trainer).opacities().into_iter().fold(0.0, f32::max)
    };
    let (linear, logistic) = (first_joint("model.opacity=linear"), first_joint("model.opacity=sigmoid"));
    assert!(linear > 0.9 && logistic < 0.9, "{linear}, {logistic}");
}

#[test]
fn methods_alone_learn() {
    // it starts with small kernels, and the rates of its paper are too low for so few steps
    let faster = ["optimizer.base=0.02", "optimizer.log_scales=0.1"];
    for method in ["2dgs", "mcmc", "dbs", "3dgs", "absgs", "stopthepop", "mip-splatting", "htgs", "sss", "sortfree"] {
        let set: &[&str] = if method == "sss" { &faster } else { &[] };
        let method = format!("train.method={method}");
        let mut trainer = trainer(&[&["train.steps=60", &method, "refine.budget=500"], set].concat());
        let mut loss = Vec::new();
        while !trainer.is_finished() {
            let ("rgb", rgb) = trainer.step().unwrap().unwrap().terms[0] else { panic!("L_rgb comes first") };
            loss.push(rgb);
        }
        let mean = |part: &[f64]| part.iter().sum::<f64>() / part.len() as f64;
        let (early, late) = (mean(&loss[..6]), mean(&loss[54..]));
        assert!(late < 0.8 * early, "{method}: {early} at first, {late} at last");
    }
}

#[test]
fn density_control_begins_with_half_its_budget() {
    for (method, count) in [("2dgs", 100), ("3dgs", 100), ("sortfree", 100), ("mcmc", 200), ("sss", 200)] {
        let method = format!("train.method={method}");
        let set = ["train.steps=9", "refine.budget=200", "init.method=random", "init.random_gaussians=1000", &method];
        assert_eq!(trainer(&set).scene().gaussians.len(), count, "{method}");
    }
}

#[test]
fn what_is_summed_is_never_removed_and_learns_what_its_gaussians_have_in_common() {
    for weight in ["dir", "exp", "lc"] {
        let weight = format!("weighted_sum.weight={weight}");
        let mut trainer = trainer(&[
            "train.steps=60",
            "train.method=sortfree",
            &weight,
            "refine.budget=600",
            "density.gradient_threshold=1e-7",
        ]);
        let start = trainer.scene();
        let mut count = start.gaussians.len();
        while !trainer.is_finished() {
            let report = trainer.step().unwrap().unwrap();
            assert!(report.gaussians >= count, "{weight}: {count} Gaussians became {}", report.gaussians);
            count = report.gaussians;
        }
        assert_eq!(count, 600, "{weight}");
        let scene = trainer.scene();
        assert_eq!(scene.info.rendering, Rendering::Summed);
        assert_eq!(scene.info.colour_model.to_string(), "sh3+opacity");
        assert!(scene.gaussians.opacity_detail.iter().any(|&k| k != 0.0), "{weight}");
        let [before, after] = [&start, &scene].map(|scene| scene.info.weighted_sum.clone().unwrap());
        let changed = [before.sigma != after.sigma, before.beta != after.beta];
        let learns = [!weight.ends_with("dir"), weight.ends_with("exp")];
        assert_eq!(changed, learns, "{weight}: {before:?}, {after:?}");
        assert!(after.background >= before.background, "{weight}: {before:?}, {after:?}");
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("scene.safetensors");
        scene.save(&path).unwrap();
        assert_eq!(SceneData::load(&path).unwrap(), scene);
    }
}

#[test]
fn scenes_of_htgs_say_which_fragments_have_an_order() {
    for transparency in ["hybrid", "nearest", "sorted", "tail"] {
        let set = format!("density.transparency={transparency}");
        let scene = trained(&["train.steps=90", "train.method=htgs", &set, "refine.budget=500"], dataset()).scene();
        let found = (scene.info.rendering, scene.info.blend_order.to_string());
        assert_eq!(found, (Rendering::Ellipsoids, transparency.into()));
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("scene.safetensors");
        scene.save(&path).unwrap();
        assert_eq!(SceneData::load(&path).unwrap(), scene);
    }
}

#[test]
fn plans_that_lack_something_are_refused_before_the_first_step() {
    let error = |set: &[&str]| match Trainer::new(config(set), dataset(), device()) {
        Err(error) => error.to_string(),
        Ok(_) => panic!("not refused"),
    };
    assert!(error(&["train.lambda_disc_normal=0.05"]).contains("stages.surfels above 0"));
    assert!(error(&["stages.gaussians_by=rest"]).contains("needs discs"));
    assert!(error(&["train.stop=validation"]).contains("validation views"));
    let absent = error(&["stages.surfels_from=absent.safetensors"]);
    assert!(absent.contains("stages.surfels_from") && absent.contains("absent.safetensors"), "{absent}");
    let mut scene = trainer(&["train.method=mcmc"]).scene();
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("far.safetensors");
    scene.info.offset = [5e6, 0.0, 0.0];
    scene.save(&file).unwrap();
    let far = error(&["train.method=mcmc", &format!("stages.gaussians_from={}", file.display())]);
    assert!(far.contains("far.safetensors") && far.contains("no training view shows any of it"), "{far}");
}

#[test]
fn rates_decay_in_the_last_stage_only() {
    let colours = |set: &[&str], steps: usize| {
        after(trainer(&[set, &["train.steps=20"]].concat()), steps).scene().gaussians.colour
    };
    let (constant, decaying) = ("optimizer.decay=1", "optimizer.decay=1e-3");
    for set in [["train.method=mcmc", "stages.gaussians=0"], ["train.method=dpges", "stages.gaussians=0"]] {
        let of = |decay| colours(&[&set[..], &[decay]].concat(), 20);
        assert!(of(constant) != of(decaying), "{set:?}");
    }
    let of = |decay, steps| colours(&["stages.gaussians=0.5", decay], steps);
    assert!(of(constant, 10) == of(decaying, 10), "the stage of Gaussians has learnt at other rates");
    assert!(of(constant, 20) != of(decaying, 20), "the joint stage has not");
}

#[test]
fn the_joint_stage_ends_above_the_gaussians_that_it_begins_with() {
    let data = Arc::new(builtin(&options(48, [16, 6], 400)));
    let set = ["train.steps=900", "refine.budget=1500", "refine.surfel_pixels=1px/MP"].map(str::to_owned);
    let mut trainer = Trainer::new(Config::resolve(None, None, &set).unwrap(), data.clone(), device()).unwrap();
    let psnr = |trainer: &Trainer| evaluate(&trainer.scene(), &data.test, trainer.device()).unwrap().psnr;
    step_until(&mut trainer, Trainer::stage_is_over);
    let gaussians = psnr(&trainer);
    step_until(&mut trainer, Trainer::is_finished);
    let joint = psnr(&trainer);
    println!("held out: {gaussians:.2} dB of Gaussians, {joint:.2} dB after the joint stage");
    assert_eq!(trainer.stage().kind, StageKind::Joint);
    assert!(joint >= gaussians, "{joint:.2} dB, {gaussians:.2} dB before");
}
