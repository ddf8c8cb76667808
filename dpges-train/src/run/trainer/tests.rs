use std::collections::BTreeSet;
use std::path::Path;

use dpges_core::camera::CameraFromWorld;
use dpges_core::scene::tensors::tensor_to_rows;
use dpges_core::scene::{EnvironmentData, Rendering, ScreenFilter};
use glam::DVec3;

use super::super::fixtures::{config, dataset, dataset_of, device};
use super::*;
use crate::config::StageKind;
use crate::dataset::{BuiltinOptions, DepthKind, View, builtin, builtin_geometry};
use crate::eval::{Evaluation, Measures, evaluate_each};
use crate::exposure::Correction;
use crate::pose::PoseCorrection;
use crate::pose_gauge::Gauge;
use crate::refine::growth::Growth;
use crate::rendered::Renderer;
use crate::scene_state::GaussianState;

fn trainer(set: &[&str]) -> Trainer {
    Trainer::new(config(set), dataset(), device()).unwrap()
}

/// All stages and everything that changes something in them.
const STAGES: [&str; 16] = [
    "train.steps=60",
    "train.lambda_opacity=0.01",
    "train.lambda_gaussian_scale=0.01",
    "model.environment=sh1",
    "model.sampling_limit=0.3",
    "refine.budget=700",
    "stages.surfels=0.3",
    "stages.gaussians=0.3",
    "stages.surfel_opacity=0.12",
    "train.lambda_depth=0.1",
    "train.lambda_normal=0.05",
    "train.lambda_depth_normal=0.05",
    "relocation.every=1000",
    "discs.densify_every=1000",
    "discs.gradient_threshold=1e-7",
    "relocation.min_opacity=0.3",
];

fn finished(mut trainer: Trainer) -> Checkpoint {
    while !trainer.is_finished() {
        trainer.step().unwrap();
    }
    trainer.checkpoint()
}

fn saved_and_loaded(checkpoint: &Checkpoint, folder: &Path) -> Checkpoint {
    let path = folder.join("checkpoint.safetensors");
    checkpoint.save(&path).unwrap();
    Checkpoint::load(&path).unwrap()
}

#[test]
fn frozen_surfels_learn_nothing_but_colours() {
    let mut trainer = trainer(&["train.steps=9", "train.freeze_surfels=true"]);
    let before = trainer.scene();
    while !trainer.is_finished() {
        trainer.step().unwrap();
    }
    let after = trainer.scene();
    assert!(!before.surfels.is_empty());
    assert_eq!(after.surfels.positions, before.surfels.positions);
    assert_eq!(after.surfels.quaternions, before.surfels.quaternions);
    assert_eq!(after.surfels.log_scales, before.surfels.log_scales);
    assert_ne!(after.surfels.colour, before.surfels.colour);
    assert_ne!(after.gaussians.positions, before.gaussians.positions);
}

fn gaussians(trainer: &mut Trainer) -> &mut GaussianState {
    trainer.stage.parameters().gaussians
}

#[test]
fn gaussians_that_draw_nothing_are_in_no_scene_and_make_room_for_others() {
    for (set, replaced) in [("refine.replace_until=20000", true), ("refine.replace_until=0", false)] {
        // batches after 12, 16, …, 48 steps, replacements after 52, …, 76
        let mut trainer = trainer(&["train.steps=100", "refine.budget=300", "refine.split=false", set]);
        while trainer.completed_steps() < 52 {
            trainer.step().unwrap();
        }
        let mut opacities = gaussians(&mut trainer).opacities();
        let (count, left) = (opacities.len(), opacities.iter().filter(|&&o| o > 0.1).count());
        assert!(left > 20 && left < count, "{left} of {count}");
        opacities.iter_mut().filter(|o| **o <= 0.1).for_each(|o| *o = -1.0);
        gaussians(&mut trainer).reset_opacities(&opacities);
        assert_eq!(trainer.scene().gaussians.len(), left);

        let report = trainer.step().unwrap().unwrap();
        let said = format!("{} Gaussians that draw nothing removed", count - left);
        assert_eq!(report.events.iter().any(|event| event.contains(&said)), replaced, "{:?}", report.events);
        let alive = gaussians(&mut trainer).opacities().iter().filter(|&&o| o > 0.0).count();
        assert_eq!(alive > left, replaced, "{alive}, {left} before");
    }
}

#[test]
fn what_hides_points_from_views_that_saw_them_is_removed_if_that_is_wanted() {
    for (set, is_wanted) in [("refine.clear_sight=true", true), ("refine.clear_sight=false", false)] {
        // batches after 12, 16, …, 48 steps
        let mut trainer = trainer(&["train.steps=100", "refine.budget=300", "refine.split=false", set]);
        while trainer.completed_steps() < 48 {
            trainer.step().unwrap();
        }
        // the first Gaussian hides what two cameras have before them
        let data = dataset();
        let centres: Vec<DVec3> = data.train.iter().map(|view| view.camera.centre()).collect();
        let near = |a: &DVec3, b: &DVec3| a.distance(centres[0]).total_cmp(&b.distance(centres[0]));
        let other = *centres[1..].iter().min_by(|a, b| near(a, b)).unwrap();
        let ahead = data.train[0].camera.camera_from_world.rotation.transpose() * DVec3::Z;
        let distance = centres[0].distance(other);
        let middle = 0.5 * (centres[0] + other) + distance * ahead;
        let gaussians = gaussians(&mut trainer);
        let mut positions = tensor_to_rows(&gaussians.columns.positions.raw());
        positions[..3].copy_from_slice(&middle.as_vec3().to_array());
        gaussians.columns.positions.set(&positions);
        let mut log_scales = tensor_to_rows(&gaussians.columns.log_scales.raw());
        log_scales[..3].fill((0.5 * distance).ln() as f32);
        gaussians.columns.log_scales.set(&log_scales);
        let mut opacities = gaussians.opacities();
        opacities[0] = 0.9;
        gaussians.reset_opacities(&opacities);

        let events = trainer.step().unwrap().unwrap().events;
        let removed = events.iter().find_map(|event| event.split_once(" Gaussians removed that hide points"));
        let count = removed.map(|(before, _)| before.rsplit(' ').next().unwrap().parse::<usize>().unwrap());
        assert_eq!(count.is_some_and(|count| count > 0), is_wanted, "{events:?}");
    }
}

#[test]
fn gaussians_are_added_where_no_surfel_is_if_that_is_wanted() {
    for (set, grows) in [("refine.add_everywhere=true", true), ("refine.add_everywhere=false", false)] {
        let few = ["train.steps=40", "init.method=random", "init.random_gaussians=100", "refine.budget=300"];
        let mut trainer = trainer(&[&few[..], &["refine.split=false", set]].concat());
        assert!(trainer.scene().surfels.is_empty());
        while !trainer.is_finished() {
            trainer.step().unwrap();
        }
        assert_eq!(gaussians(&mut trainer).len() > 100, grows, "{set}");
    }
}

#[test]
fn stages_hand_on_what_they_trained() {
    let mut trainer = trainer(&STAGES);
    let mut seen = Vec::new();
    let mut events = Vec::new();
    while !trainer.is_finished() {
        let report = trainer.step().unwrap().unwrap();
        assert!(report.loss.is_finite() && report.psnr > 0.0, "{report:?}");
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
    let opaque = discs.gaussians.opacities.iter().filter(|&&opacity| opacity > 0.12).count();
    assert!(opaque > 10 && joint.surfels.len() <= opaque, "{opaque}, {}", joint.surfels.len());
    assert!(discs.gaussians.len() <= 210 && gaussians.gaussians.len() <= 420);
    assert!(events.iter().any(|event| event.contains("discs added by densification")), "{events:?}");
}

#[test]
fn an_environment_learns_in_every_stage_and_goes_from_one_to_the_next() {
    let mut trainer = trainer(&STAGES);
    let mut before = trainer.scene().environment.unwrap();
    assert_eq!(before, EnvironmentData::neutral(1));
    for stage in ["2dgs", "dbs", "joint"] {
        assert_eq!(trainer.scene().environment.as_ref(), Some(&before), "{stage}");
        while !trainer.stage_is_over() {
            trainer.step().unwrap();
        }
        assert_eq!(trainer.stage().kind.to_string(), stage);
        let after = trainer.scene().environment.unwrap();
        let pairs = after.coefficients.iter().zip(&before.coefficients);
        assert!(pairs.clone().count() == 12 && pairs.clone().all(|(a, b)| a != b), "{stage}: {after:?}");
        before = after;
        if !trainer.is_in_last_stage() {
            trainer.next_stage().unwrap();
        }
    }
    assert_eq!(self::trainer(&["train.steps=9"]).scene().environment, None);
}

#[test]
fn a_run_goes_on_from_any_step_of_any_stage_to_the_same_end() {
    let folder = tempfile::tempdir().unwrap();
    let with_exposure = [&STAGES[..], &["train.exposure=on"]].concat();
    let with_poses = [&STAGES[..], &["train.poses=on"]].concat();
    let runs: [(&[&str], &[usize]); 7] = [
        (&STAGES, &[7, 18, 19, 30, 36, 50]),
        (&with_exposure, &[7, 18, 50]),
        (&with_poses, &[1, 7, 18, 19, 50]),
        (&["train.steps=40", "train.method=mcmc", "refine.budget=300", "model.environment=sh2"], &[1, 25]),
        (&["train.steps=40", "train.method=dbs", "refine.budget=300"], &[25]),
        (&["train.steps=40", "train.method=mip-splatting", "refine.budget=300"], &[11, 25]),
        (&["train.steps=40", "train.method=2dgs", "refine.budget=300", "model.colour=sh1"], &[25]),
    ];
    for (set, stops) in runs {
        let whole = finished(trainer(set));
        for &stop in stops {
            let mut first = trainer(set);
            while first.completed_steps() < stop {
                first.step().unwrap();
            }
            let checkpoint = saved_and_loaded(&first.checkpoint(), folder.path());
            let second = Trainer::resume(checkpoint, dataset(), device()).unwrap();
            assert!(finished(second) == whole, "{set:?} stopped after {stop}");
        }
    }
}

/// Every 3rd of 9 views validates, and no batch is worth it: a control after 8 steps, a batch after 12 that settles
/// after 16, a control after 20, the end of growth after 24.
fn automatic() -> (Config, Arc<Dataset>) {
    let mut data = (*dataset_of(9)).clone();
    data.keep_for_validation(3);
    let set = ["train.steps=100", "refine.budget=auto", "refine.least_gain=100", "refine.split=false"];
    (config(&set), Arc::new(data))
}

#[test]
fn an_automatic_budget_ends_growth_after_a_batch_that_is_not_worth_it() {
    let (config, data) = automatic();
    let mut trainer = Trainer::new(config, data, device()).unwrap();
    let (mut told, mut counts) = (Vec::new(), Vec::new());
    while !trainer.is_finished() {
        let report = trainer.step().unwrap().unwrap();
        let of_growth = |event: &&String| event.starts_with("batch of") || event.starts_with("validation error");
        told.extend(report.events.iter().filter(of_growth).map(|event| (report.step, event.clone())));
        counts.push(gaussians(&mut trainer).len());
    }
    let steps: Vec<usize> = told.iter().map(|&(step, _)| step).collect();
    assert_eq!(steps, [13, 17, 21, 25], "{told:?}");
    assert!(told[0].1.contains("4 steps without new Gaussians"), "{told:?}");
    assert!(told[1].1.ends_with("the batch is given time to settle"), "{told:?}");
    assert!(told[2].1.ends_with("an interval without a batch follows"), "{told:?}");
    assert!(told[3].1.ends_with("growth stops"), "{told:?}");
    // counts[n] is that after step n + 1
    assert!(counts[12] > counts[11], "{counts:?}");
    assert!(counts[13..].iter().all(|&count| count <= counts[12]), "{counts:?}");
}

#[test]
fn a_run_goes_on_from_the_middle_of_an_interval_of_growth() {
    let folder = tempfile::tempdir().unwrap();
    let (config, data) = automatic();
    let begin = || Trainer::new(config.clone(), data.clone(), device()).unwrap();
    let whole = finished(begin());
    for stop in [10, 12, 14, 18, 22, 30] {
        let mut first = begin();
        while first.completed_steps() < stop {
            first.step().unwrap();
        }
        let checkpoint = saved_and_loaded(&first.checkpoint(), folder.path());
        let is_running = checkpoint.state.growth.as_ref().is_some_and(Growth::is_running);
        assert_eq!(is_running, stop < 24);
        let second = Trainer::resume(checkpoint, data.clone(), device()).unwrap();
        assert!(finished(second) == whole, "stopped after {stop}");
    }
}

#[test]
fn surfels_enter_where_views_agree_and_leave_where_they_do_harm() {
    let set = [
        "train.steps=300",
        "stages.gaussians=0.7",
        "refine.budget=1500",
        "refine.judge_surfels_at=[0, 1000]",
        "refine.surfel_prune_from=15000",
    ];
    let options = BuiltinOptions { width: 40, height: 40, train_views: 12, points: 400, ..Default::default() };
    let dataset = Arc::new(builtin(&options));
    let mut trainer = Trainer::new(config(&set), dataset.clone(), device()).unwrap();
    while trainer.stage().kind != StageKind::Joint {
        trainer.step().unwrap();
    }
    let surfels = trainer.scene().surfels;
    assert!((10..=300).contains(&surfels.len()), "{}", surfels.len());
    // their centres are on the surfaces of the room
    let depths: Vec<Vec<f32>> = dataset.train.iter().map(|view| builtin_geometry(&view.camera).0).collect();
    let on_surface = |position: &[f32; 3]| {
        let world = DVec3::from_array(position.map(f64::from));
        let errors = dataset.train.iter().zip(&depths).filter_map(|(view, depth)| {
            let (x, y, z) = view.camera.project(world)?;
            let inside = x >= 0.0 && y >= 0.0 && x < 40.0 && y < 40.0;
            inside.then(|| (f64::from(depth[y as usize * 40 + x as usize]) - z).abs() / z)
        });
        errors.fold(f64::INFINITY, f64::min) < 0.05
    };
    let good = surfels.positions.as_chunks::<3>().0.iter().filter(|position| on_surface(position)).count();
    assert!(good * 5 >= surfels.len() * 4, "{good} of {}", surfels.len());

    // three of them close before cameras, in a colour of no photograph, leave where they are judged
    while trainer.completed_steps() < 214 {
        trainer.step().unwrap();
    }
    let mut wrong = trainer.scene().surfels;
    for row in 0..3 {
        let position = dataset.train[4 * row].camera.unproject(20.0, 20.0, 1.0).as_vec3();
        wrong.positions[3 * row..][..3].copy_from_slice(&position.to_array());
        wrong.colour.base[3 * row..][..3].fill(20.0);
    }
    let surfels = trainer.stage.parameters().surfels;
    surfels.columns.positions.set(&wrong.positions);
    surfels.columns.colour.base.set(&wrong.colour.base);
    let events = trainer.step().unwrap().unwrap().events;
    assert!(events.iter().any(|event| event.contains("surfels removed")), "{events:?}");
    let after = trainer.scene().surfels;
    assert!(!after.is_empty() && after.colour.base.iter().all(|&base| base < 15.0), "{:?}", after.colour.base);
}

#[test]
fn only_linear_opacities_become_odds() {
    let first_joint = |opacity: &str| {
        let set = ["train.steps=40", "stages.gaussians=0.5", "refine.budget=300", opacity];
        let mut trainer = trainer(&set);
        while trainer.stage().kind != StageKind::Joint {
            trainer.step().unwrap();
        }
        gaussians(&mut trainer).opacities().into_iter().fold(0.0, f32::max)
    };
    let (linear, logistic) = (first_joint("model.opacity=linear"), first_joint("model.opacity=sigmoid"));
    assert!(linear > 0.9 && logistic < 0.9, "{linear}, {logistic}");
}

#[test]
fn all_views_are_seen_between_two_changes_that_judge_by_views() {
    // 7 views, stages of 40, 40 and 120 steps: no stage begins where a pass over the views would
    let views = 7;
    let set = ["train.steps=200", "stages.surfels=0.2", "stages.gaussians=0.2", "refine.surfel_min_pixels=0"];
    let mut trainer = Trainer::new(config(&set), dataset_of(views), device()).unwrap();
    let mut stage = trainer.stage();
    // views since the last of these events, and their number at each of them
    let mut windows = ["added by densification", "surfels pruned", "Gaussians pruned"]
        .map(|event| (event, BTreeSet::new(), Vec::<usize>::new()));
    while !trainer.is_finished() {
        let report = trainer.step().unwrap().unwrap();
        for (event, seen, counts) in &mut windows {
            if trainer.stage() != stage {
                seen.clear();
            }
            if report.events.iter().any(|said| said.contains(*event)) {
                counts.push(seen.len());
                seen.clear();
            }
            seen.insert(report.view);
        }
        stage = trainer.stage();
    }
    for (event, _, counts) in windows {
        assert!(!counts.is_empty() && counts.iter().all(|&count| count == views), "{event}: {counts:?}");
    }
}

#[test]
fn methods_alone_learn() {
    for method in ["2dgs", "mcmc", "dbs", "3dgs", "absgs", "mip-splatting"] {
        let method = format!("train.method={method}");
        let mut trainer = trainer(&["train.steps=60", &method, "refine.budget=500"]);
        let mut loss = Vec::new();
        while !trainer.is_finished() {
            loss.push(trainer.step().unwrap().unwrap().rgb);
        }
        let mean = |part: &[f64]| part.iter().sum::<f64>() / part.len() as f64;
        let (early, late) = (mean(&loss[..6]), mean(&loss[54..]));
        assert!(late < 0.8 * early, "{method}: {early} at first, {late} at last");
    }
}

#[test]
fn what_is_fine_is_drawn_as_coarse_as_the_views_resolve_it() {
    let mut trainer = trainer(&["train.steps=20", "train.method=mip-splatting", "refine.budget=300"]);
    let log_scales = |trainer: &mut Trainer| gaussians(trainer).to_data().log_scales;
    let fine = vec![-20.0; log_scales(&mut trainer).len()];
    gaussians(&mut trainer).columns.log_scales.set(&fine);
    let scene = trainer.scene();
    // a pixel of a view of 24 px is more than 0.01 of this scene, which is about 2 wide
    assert!(scene.gaussians.log_scales.iter().all(|&scale| f64::from(scale).exp() > 0.447 * 0.01));
    assert!(scene.gaussians.opacities.iter().all(|&opacity| opacity < 1e-6), "what has no size has no weight");
    assert_eq!(scene.info.screen_filter, ScreenFilter::Compensated);
}

#[test]
fn exposures_are_learnt_around_their_mean_in_every_stage() {
    let mut trainer = trainer(&[&STAGES[..], &["train.exposure=on"]].concat());
    let mut before = vec![0.0; 18];
    for stage in ["2dgs", "dbs", "joint"] {
        while !trainer.stage_is_over() {
            trainer.step().unwrap();
        }
        assert_eq!(trainer.stage().kind.to_string(), stage);
        let checkpoint = trainer.checkpoint();
        let after = checkpoint.attributes["exposure"].raw.clone();
        assert!(after.iter().zip(&before).all(|(a, b)| a != b), "{stage}: {after:?}");
        for column in 0..6 {
            let sum: f32 = after.iter().skip(column).step_by(6).sum();
            assert!(sum.abs() < 1e-5, "{stage}: column {column} sums to {sum}");
        }
        let named = trainer.view_corrections().exposure.unwrap();
        assert_eq!(named.keys().collect::<Vec<_>>(), ["train_000", "train_001", "train_002"]);
        assert!((named["train_001"].gain[0].ln() - f64::from(after[6])).abs() < 1e-6);
        before = after;
        if !trainer.is_in_last_stage() {
            trainer.next_stage().unwrap();
        }
    }
    let without = self::trainer(&["train.steps=9"]);
    assert!(!without.corrects_exposure() && without.view_corrections() == ViewCorrections::default());
}

#[test]
fn exposures_are_found_and_compensated() {
    let options =
        BuiltinOptions { width: 32, height: 32, train_views: 8, test_views: 4, points: 400, ..Default::default() };
    let plain = builtin(&options);
    let changed = Arc::new(builtin(&BuiltinOptions { exposure_stops: 1.0, ..options }));
    let trained = |exposure: &str| {
        let set = ["train.steps=400", "refine.budget=1500", "optimizer.exposure=0.02", exposure];
        let mut trainer = Trainer::new(config(&set), changed.clone(), device()).unwrap();
        while !trainer.is_finished() {
            trainer.step().unwrap();
        }
        let scene = trainer.scene();
        let renderer = Renderer::new(&scene, &device());
        let measures = Measures::BASIC.fitted(true);
        let evaluation: dpges_core::Result<Evaluation> =
            evaluate_each(&renderer, &scene, &changed.test, &device(), measures, |_, _| Ok(()));
        (evaluation.unwrap().fitted.psnr_fitted.unwrap(), trainer.view_corrections().exposure)
    };
    let (with, found) = trained("train.exposure=auto");
    let (without, none) = trained("train.exposure=off");
    assert!(with > without && none.is_none(), "{with} with, {without} dB without");

    // by how much each photograph is brighter than the scene, and than the others
    let brightness =
        |view: &View| f64::from(view.picture().unwrap().planes().iter().sum::<f32>() / (3.0 * 32.0 * 32.0));
    let found = found.expect("exposures differ by more than auto takes");
    let pairs = changed.train.iter().zip(&plain.train);
    let (truth, learnt): (Vec<f64>, Vec<f64>) = pairs
        .map(|(changed, plain)| {
            let (scene, Correction { gain, offset }) = (brightness(plain), found[&changed.name]);
            let shown = (0..3).map(|channel| gain[channel] * scene + offset[channel]).sum::<f64>() / 3.0;
            ((brightness(changed) / scene).ln(), (shown / scene).ln())
        })
        .unzip();
    let centred = |values: &[f64]| {
        let mean = values.iter().sum::<f64>() / values.len() as f64;
        values.iter().map(|value| value - mean).collect::<Vec<f64>>()
    };
    let (truth, learnt) = (centred(&truth), centred(&learnt));
    let wrong: f64 = truth.iter().zip(&learnt).map(|(a, b)| (a - b).powi(2)).sum();
    let all: f64 = truth.iter().map(|a| a.powi(2)).sum();
    assert!(wrong < 0.25 * all, "{truth:?} {learnt:?}");
}

#[test]
fn poses_are_learnt_in_every_stage_but_for_what_all_have_in_common() {
    let poses = ["train.poses=on", "optimizer.pose_from=0"];
    let mut trainer = trainer(&[&STAGES[..], &poses].concat());
    let recorded = dataset();
    let cameras: Vec<CameraFromWorld> = recorded.train.iter().map(|view| view.camera.camera_from_world).collect();
    let gauge = Gauge::new(&cameras, recorded.extent);
    let mut before = vec![0.0; 18];
    for stage in ["2dgs", "dbs", "joint"] {
        while !trainer.stage_is_over() {
            trainer.step().unwrap();
        }
        assert_eq!(trainer.stage().kind.to_string(), stage);
        let after = trainer.checkpoint().attributes["poses"].raw.clone();
        assert!(after.iter().zip(&before).all(|(a, b)| a != b), "{stage}: {after:?}");
        let rows = after.as_chunks().0.iter();
        let common = gauge.common(&rows.map(PoseCorrection::of_row).collect::<Vec<_>>());
        let size = common.turn.length() + common.shift.length() + common.growth.abs();
        assert!(size < 1e-6, "{stage}: {common:?}");
        let poses = trainer.refined_poses().unwrap();
        assert_eq!(poses.keys().collect::<Vec<_>>(), ["train_000", "train_001", "train_002"]);
        assert!((poses["train_001"].correction.rotation[2] - f64::from(after[8])).abs() < 1e-9);
        for (now, recorded) in trainer.dataset().train.iter().zip(&recorded.train) {
            let expected = poses[&now.name].correction.applied(&recorded.camera.camera_from_world);
            assert!(now.camera.camera_from_world == expected && expected != recorded.camera.camera_from_world);
        }
        let changes = trainer.pose_changes().unwrap();
        assert!(changes.mean_degrees > 0.0 && changes.largest_shift < 0.1, "{changes}");
        before = after;
        if !trainer.is_in_last_stage() {
            trainer.next_stage().unwrap();
        }
    }
    let without = self::trainer(&["train.steps=9"]);
    assert!(without.refined_poses().is_none() && !without.checkpoint().attributes.contains_key("poses"));
}

#[test]
fn cameras_that_do_not_move_change_no_bit() {
    let scene = |set: &[&str]| {
        let common = ["train.steps=40", "stages.gaussians=0.5", "refine.budget=500", "model.environment=sh1"];
        let mut trainer = trainer(&[&common[..], set].concat());
        while !trainer.is_finished() {
            trainer.step().unwrap();
        }
        trainer.scene()
    };
    let still = ["train.poses=on", "optimizer.pose_rotation=0", "optimizer.pose_translation=0"];
    let without = scene(&[]);
    assert!(scene(&still) == without, "the probe of a pose changes nothing");
    assert!(scene(&["train.poses=off"]) == without);
    assert!(scene(&["train.poses=on", "optimizer.pose_from=0.99"]) == without, "poses have not begun");
    assert!(scene(&["train.poses=on"]) != without);
}

/// Mean distance in the pictures, px, between where cameras of `found` and the training cameras of `truth` see the
/// points that these saw.
fn misplacement(found: &Dataset, truth: &Dataset) -> f64 {
    let (mut sum, mut count) = (0.0, 0.0);
    for (position, seen_by) in truth.points.positions.iter().zip(&truth.points.seen_by) {
        let world = DVec3::from_array(position.map(f64::from));
        for &view in seen_by {
            let [found, truth] = [found, truth].map(|data| data.train[view as usize].camera.project(world));
            let (Some((x, y, _)), Some((true_x, true_y, _))) = (found, truth) else { continue };
            (sum, count) = (sum + (x - true_x).hypot(y - true_y), count + 1.0);
        }
    }
    sum / count
}

#[test]
fn misplaced_cameras_are_put_back() {
    let options =
        BuiltinOptions { width: 48, height: 48, train_views: 12, test_views: 1, points: 800, ..Default::default() };
    let truth = builtin(&options);
    // neither what is wrong nor what corrects it has a mean: little that all cameras have in common stands between
    let wrong = Arc::new(builtin(&BuiltinOptions { pose_degrees: 0.2, pose_extents: 0.005, ..options }));
    let set = ["train.steps=720", "refine.budget=2000", "train.poses=on"];
    let mut trainer = Trainer::new(config(&set), wrong.clone(), device()).unwrap();
    while !trainer.is_finished() {
        trainer.step().unwrap();
    }
    let (before, after) = (misplacement(&wrong, &truth), misplacement(trainer.dataset(), &truth));
    assert!(after < 0.5 * before, "{after} px, {before} px before; {}", trainer.pose_changes().unwrap());
}

/// Of the surfels of `trainer` in a training view of the built-in scene.
fn mean_depth_error(trainer: &Trainer, view: &View) -> f64 {
    let scene = trainer.scene();
    let (_, depth) = Renderer::new(&scene, &device()).render_with_depth(&view.camera).unwrap();
    let (truth, _) = builtin_geometry(&view.camera);
    let shown: Vec<f64> = depth
        .iter()
        .zip(&truth)
        .filter(|(z, _)| **z > 0.0)
        .map(|(z, truth)| f64::from((z / truth - 1.0).abs()))
        .collect();
    assert!(shown.len() > 200, "{} pixels", shown.len());
    shown.iter().sum::<f64>() / shown.len() as f64
}

#[test]
fn depth_maps_bring_surfels_to_their_depth() {
    let size = BuiltinOptions { width: 32, height: 32, train_views: 6, points: 500, ..Default::default() };
    let error = |kind: Option<DepthKind>| {
        let mut data = builtin(&BuiltinOptions { depth: kind, ..size.clone() });
        // along the first axis by up to 0.15
        let positions = data.points.positions.iter_mut().enumerate();
        positions.for_each(|(at, position)| position[0] += 0.3 * ((at * 37 % 101) as f32 / 101.0 - 0.5));
        let set = [
            "train.steps=150",
            "refine.budget=1200",
            "train.lambda_depth_maps=2",
            "train.depth_maps_decay=1",
            // surfels stay, however wrong they are
            "refine.judge_surfels_at=[]",
            "refine.surfel_prune_from=15000",
            "refine.clear_sight=false",
            "optimizer.position_start=1e-3",
            "optimizer.position_end=1e-3",
        ];
        let mut trainer = Trainer::new(config(&set), Arc::new(data), device()).unwrap();
        while !trainer.is_finished() {
            trainer.step().unwrap();
        }
        let views = &trainer.dataset().train;
        views.iter().map(|view| mean_depth_error(&trainer, view)).sum::<f64>() / views.len() as f64
    };
    let (without, metric) = (error(None), error(Some(DepthKind::Metric)));
    assert!(metric < 0.8 * without, "{metric} with maps, {without} without");
}

#[test]
fn stages_learn_from_depth_maps_and_resume() {
    let folder = tempfile::tempdir().unwrap();
    for kind in [DepthKind::Metric, DepthKind::Relative] {
        let options =
            BuiltinOptions { width: 24, height: 24, train_views: 3, test_views: 1, points: 200, ..Default::default() };
        let data = Arc::new(builtin(&BuiltinOptions { depth: Some(kind), ..options }));
        let whole = finished(Trainer::new(config(&STAGES), data.clone(), device()).unwrap());
        assert!(whole.attributes != finished(trainer(&STAGES)).attributes, "maps change something");
        let mut first = Trainer::new(config(&STAGES), data.clone(), device()).unwrap();
        while first.completed_steps() < 25 {
            first.step().unwrap();
        }
        let checkpoint = saved_and_loaded(&first.checkpoint(), folder.path());
        assert!(finished(Trainer::resume(checkpoint, data, device()).unwrap()) == whole, "{kind:?}");
    }
}

#[test]
fn a_run_that_corrects_everything_at_once_goes_on_to_the_same_end() {
    let size = 24;
    let options = BuiltinOptions {
        width: size,
        height: size,
        train_views: 9,
        test_views: 1,
        points: 400,
        depth: Some(DepthKind::Relative),
        exposure_stops: 0.5,
        pose_degrees: 0.2,
        fisheye: true,
        ..Default::default()
    };
    let mut data = builtin(&options);
    let counted: Vec<bool> = (0..size * size).map(|pixel| pixel % size > 5).collect();
    data.train[2].repaint(|picture| picture.counted = Some(counted)).unwrap();
    data.keep_for_validation(3);
    let data = Arc::new(data);
    let set = [
        "train.steps=80",
        "train.poses=on",
        "train.exposure=on",
        "stages.gaussians=0.3",
        "refine.budget=auto",
        "refine.add_agreement=1",
        "model.environment=sh1",
        "model.sampling_limit=0.3",
    ];
    let begun = || Trainer::new(config(&set), data.clone(), device()).unwrap();
    let whole = finished(begun());
    for corrections in ["poses", "exposure"] {
        assert!(whole.attributes[corrections].raw.iter().all(|number| *number != 0.0), "{corrections}");
    }
    let folder = tempfile::tempdir().unwrap();
    for stop in [9, 24, 25, 60] {
        let mut first = begun();
        while first.completed_steps() < stop {
            first.step().unwrap();
        }
        let checkpoint = saved_and_loaded(&first.checkpoint(), folder.path());
        let second = Trainer::resume(checkpoint, data.clone(), device()).unwrap();
        assert!(finished(second) == whole, "stopped after {stop}");
    }
}

#[test]
fn plans_that_lack_something_are_refused_before_the_first_step() {
    let error = |set: &[&str]| match Trainer::new(config(set), dataset(), device()) {
        Err(error) => error.to_string(),
        Ok(_) => panic!("not refused"),
    };
    assert!(error(&["train.lambda_normal=0.05"]).contains("stages.surfels above 0"));
    assert!(error(&["stages.gaussians_by=rest"]).contains("needs discs"));
    assert!(error(&["refine.budget=auto"]).contains("validation views"));
    let absent = error(&["stages.surfels_from=absent.safetensors"]);
    assert!(absent.contains("stages.surfels_from") && absent.contains("absent.safetensors"), "{absent}");
}
