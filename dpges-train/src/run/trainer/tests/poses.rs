//! Corrections of cameras.

use std::sync::Arc;

use dpges_core::camera::CameraFromWorld;
use glam::DVec3;

use super::{STAGES, end_stage, trainer};
use crate::config::SMALLEST_BUDGET_BY_PIXELS;
use crate::dataset::{BuiltinOptions, Dataset, builtin};
use crate::run::Trainer;
use crate::run::fixtures::{config, dataset, device, options, trained};
use crate::views::pose::PoseCorrection;
use crate::views::pose::gauge::Gauge;

#[test]
fn poses_are_learnt_in_every_stage_but_for_what_all_have_in_common() {
    let poses = ["train.poses=on", "optimizer.pose_from=0"];
    let mut trainer = trainer(&[&STAGES[..], &poses].concat());
    let recorded = dataset();
    let cameras: Vec<CameraFromWorld> = recorded.train.iter().map(|view| view.camera.camera_from_world).collect();
    let gauge = Gauge::new(&cameras, recorded.extent);
    let mut before = vec![0.0; 18];
    for stage in ["2dgs", "dbs", "joint"] {
        assert_eq!(end_stage(&mut trainer), stage);
        let after = trainer.checkpoint().attributes["poses"].raw.clone();
        assert!(after.iter().zip(&before).all(|(a, b)| a != b), "{stage}: {after:?}");
        let rows = after.as_chunks().0.iter();
        let common = gauge.common(&rows.map(PoseCorrection::of_row).collect::<Vec<_>>());
        let size = common.turn.length() + common.shift.length() + common.growth.abs();
        assert!(size < 1e-6, "{stage}: {common:?}");
        let poses = trainer.view_corrections().poses.unwrap();
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
    let without = super::trainer(&["train.steps=9"]);
    assert!(without.view_corrections().poses.is_none() && !without.checkpoint().attributes.contains_key("poses"));
}

#[test]
fn cameras_that_do_not_move_change_no_bit() {
    let scene = |set: &[&str]| {
        let common = ["train.steps=40", "stages.gaussians=0.5", "refine.budget=500", "model.environment=sh1"];
        trained(&[&common[..], set].concat(), dataset()).scene()
    };
    let still = ["train.poses=on", "optimizer.poses=0"];
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
    for (position, seen_by) in truth.points.positions.iter().zip(truth.points.seen_by.iter()) {
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
    let options = options(48, [12, 1], 800);
    let truth = builtin(&options);
    // neither what is wrong nor what corrects it has a mean: little that all cameras have in common stands between
    let wrong = Arc::new(builtin(&BuiltinOptions { pose_degrees: 0.2, pose_extents: 0.005, ..options }));
    let set = ["train.steps=720", "refine.budget=2000", "train.poses=on"];
    let trainer = trained(&set, wrong.clone());
    let (before, after) = (misplacement(&wrong, &truth), misplacement(trainer.dataset(), &truth));
    assert!(after < 0.5 * before, "{after} px, {before} px before; {}", trainer.pose_changes().unwrap());
}

#[test]
fn a_budget_by_pixels_is_that_of_the_cameras_as_they_were_recorded() {
    // large enough for a budget above the smallest, with cameras that all see the same
    let dataset = Arc::new(builtin(&options(240, [3, 0], 200)));
    let begun = Trainer::new(config(&["train.poses=on"]), dataset.clone(), device()).unwrap();
    let expected = begun.context.budget;
    assert!(expected > SMALLEST_BUDGET_BY_PIXELS, "{expected}");
    // of a run whose first camera looks away from the others by now
    let mut checkpoint = begun.checkpoint();
    checkpoint.attributes.get_mut("poses").unwrap().raw[1] = 3.0;
    let resumed = Trainer::resume(checkpoint, dataset.clone(), device()).unwrap();
    assert_ne!(resumed.dataset().train[0].camera, dataset.train[0].camera);
    assert_eq!(resumed.context.budget, expected);
    assert_eq!(resumed.context.most_primitives(0.5), expected / 2);
}
