//! Runs that go on from a checkpoint, and the growth of an automatic budget, which checkpoints hold.

use std::sync::Arc;

use super::{STAGES, finished, gaussians, saved_and_loaded, trainer};
use crate::config::Config;
use crate::dataset::{BuiltinOptions, Dataset, DepthKind, builtin};
use crate::refine::growth::Growth;
use crate::run::Trainer;
use crate::run::fixtures::{config, dataset, dataset_of, device};
use crate::stage::TrainError;

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

#[test]
fn a_step_that_is_not_finite_is_undone_with_all_that_it_has_changed() {
    let folder = tempfile::tempdir().unwrap();
    let joint = ["train.steps=60", "refine.budget=700", "train.exposure=on"];
    let with_poses = [&joint[..], &["train.poses=on", "optimizer.pose_from=0"]].concat();
    let mcmc = ["train.steps=40", "train.method=mcmc", "refine.budget=300", "model.environment=sh1"];
    let density = ["train.steps=40", "train.method=3dgs", "refine.budget=300", "density.gradient_threshold=1e-7"];
    // in the middle of passes over the 3 views, at their ends, and where the scene is refined before the step
    let runs: [(&[&str], &[usize]); 4] =
        [(&joint, &[0, 1, 10, 12, 13]), (&with_poses, &[11, 12]), (&mcmc, &[1, 3, 25]), (&density, &[1, 9])];
    for (set, stops) in runs {
        let whole = finished(trainer(set));
        for &stop in stops {
            let mut broken = trainer(set);
            while broken.completed_steps() < stop {
                broken.step().unwrap();
            }
            let before = broken.checkpoint();
            broken.context.config.train.lambda_dssim = 1e39;
            let error = broken.step().unwrap_err();
            assert!(matches!(error, TrainError::Loss { step, .. } if step == stop + 1), "{error}");

            let mut undone = saved_and_loaded(&broken.checkpoint(), folder.path());
            undone.state.config = config(set);
            assert_eq!(undone.completed_steps(), stop, "{set:?}");
            // a gradient of the step before may have moved its camera
            if !undone.state.refined && !set.contains(&"train.poses=on") {
                assert!(undone == before, "{set:?}: step {} left something behind", stop + 1);
            }
            let again = Trainer::resume(undone, dataset(), device()).unwrap();
            assert!(finished(again) == whole, "{set:?} undone after {stop}");
        }
    }
}

/// Every 3rd of 9 views validates, and no batch is worth it, as black Gaussians stay black where nothing is learnt: a
/// control after 8 steps, a batch after 12 that settles after 16, a control after 20, the end of growth after 24.
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
