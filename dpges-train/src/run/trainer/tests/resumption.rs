//! Runs that go on from a checkpoint, and the growth of an automatic budget, which checkpoints hold.

use std::sync::Arc;

use super::{STAGES, after, gaussians, goes_on_alike, trainer};
use crate::config::Config;
use crate::dataset::{BuiltinOptions, Dataset, DepthKind, builtin};
use crate::run::Trainer;
use crate::run::fixtures::{config, dataset, dataset_of, device, options};

#[test]
fn a_run_goes_on_from_any_step_of_any_stage_to_the_same_end() {
    let with_exposure = [&STAGES[..], &["train.exposure=on"]].concat();
    let with_poses = [&STAGES[..], &["train.poses=on"]].concat();
    let runs: [(&[&str], &[usize]); 11] = [
        (&STAGES, &[7, 18, 19, 30, 36, 50]),
        (&with_exposure, &[7, 18, 50]),
        (&with_poses, &[1, 7, 18, 19, 50]),
        (&["train.steps=40", "train.method=mcmc", "refine.budget=300", "model.environment=sh2"], &[1, 25]),
        (&["train.steps=40", "train.method=dbs", "refine.budget=300"], &[25]),
        (&["train.steps=40", "train.method=stopthepop", "refine.budget=300"], &[11, 25]),
        (&["train.steps=200", "train.method=htgs", "refine.budget=300"], &[53, 120]),
        (&["train.steps=40", "train.method=mip-splatting", "refine.budget=300"], &[11, 25]),
        // burn-in ends after 9 steps
        (&["train.steps=40", "train.method=sss", "refine.budget=300"], &[5, 9, 20, 25]),
        (&["train.steps=40", "train.method=2dgs", "refine.budget=300", "model.colour=sh1"], &[25]),
        (&["train.steps=40", "train.method=sortfree", "weighted_sum.weight=exp", "refine.budget=300"], &[11, 25]),
    ];
    for (set, stops) in runs {
        goes_on_alike(|| trainer(set), &dataset(), stops);
    }
}

/// Every 3rd of 9 views validates, and none improves, as black Gaussians stay black where nothing is learnt: batches after
/// 12, 16, 20, 24 and 28 steps, the end of growth after 32.
fn automatic() -> (Config, Arc<Dataset>) {
    let mut data = (*dataset_of(9)).clone();
    data.keep_for_validation(3);
    let set = [
        "train.steps=100",
        "refine.budget=auto",
        "refine.split_until=0",
        "refine.new_gaussians=black",
        "optimizer.position_start=1e-12",
        "optimizer.position_end=1e-12",
        "optimizer.quaternions=0",
        "optimizer.log_scales=0",
        "optimizer.opacities=0",
        "optimizer.base=0",
        "optimizer.detail=0",
    ];
    (config(&set), Arc::new(data))
}

#[test]
fn an_automatic_budget_ends_growth_when_validation_views_do_not_improve() {
    let (config, data) = automatic();
    let mut trainer = Trainer::new(config, data, device()).unwrap();
    let (mut told, mut counts) = (Vec::new(), Vec::new());
    while !trainer.is_finished() {
        let report = trainer.step().unwrap().unwrap();
        let of_growth = |event: &&String| event.starts_with("validation PSNR");
        told.extend(report.events.iter().filter(of_growth).map(|event| (report.step, event.clone())));
        counts.push(gaussians(&mut trainer).len());
    }
    let steps: Vec<usize> = told.iter().map(|&(step, _)| step).collect();
    assert_eq!(steps, [13, 17, 21, 25, 29, 33], "{told:?}");
    assert!(told[0].1.contains("the best so far: growth to") && told[5].1.contains("growth stops at"), "{told:?}");
    // counts[n] is that after step n + 1
    assert!([12, 16, 20].iter().all(|&at| counts[at] > counts[at - 1]), "{counts:?}");
    // those for which there was no place at first are made up for
    let wanted = trainer.checkpoint().state.growth.unwrap().wanted();
    assert!(counts.iter().all(|&count| count < wanted) && told[5].1.contains(&format!("at {wanted} of")), "{counts:?}");
}

#[test]
fn a_run_goes_on_from_between_two_batches_of_growth() {
    let (config, data) = automatic();
    let begin = || Trainer::new(config.clone(), data.clone(), device()).unwrap();
    goes_on_alike(begin, &data, &[10, 12, 14, 30, 32, 38]);
    for stop in [32, 38] {
        assert_eq!(after(begin(), stop).checkpoint().state.growth.unwrap().has_ended(), stop > 32);
    }
}

#[test]
fn a_run_that_corrects_everything_at_once_goes_on_to_the_same_end() {
    let size = 24;
    let options = BuiltinOptions {
        depth: Some(DepthKind::Relative),
        exposure_stops: 0.5,
        pose_degrees: 0.2,
        fisheye: true,
        ..options(size, [9, 1], 400)
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
        "model.environment=sh1",
        "model.sampling_limit=0.3",
    ];
    let begun = || Trainer::new(config(&set), data.clone(), device()).unwrap();
    let whole = goes_on_alike(begun, &data, &[9, 24, 25, 60]);
    for corrections in ["poses", "exposure"] {
        assert!(whole.attributes[corrections].raw.iter().all(|number| *number != 0.0), "{corrections}");
    }
}

#[test]
fn a_run_does_not_go_on_with_cameras_that_were_moved() {
    let checkpoint = after(trainer(&["train.steps=6"]), 2).checkpoint();
    let mut moved = Dataset::clone(&dataset());
    moved.train[1].camera.camera_from_world.translation.x += 1e-9;
    let error = Trainer::resume(checkpoint, Arc::new(moved), device()).err().unwrap().to_string();
    assert!(error.contains("the cameras of 1 of its training views") && error.contains("--overwrite"), "{error}");
}
