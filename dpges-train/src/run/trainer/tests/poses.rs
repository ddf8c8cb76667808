//! Corrections of cameras.

use std::sync::Arc;

use glam::DVec3;

use crate::config::SMALLEST_BUDGET_BY_PIXELS;
use crate::dataset::{BuiltinOptions, Dataset, builtin};
use crate::run::Trainer;
use crate::run::fixtures::{config, dataset, device, options, trained};

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
