//! Measured points.

use std::sync::Arc;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::goes_on_alike;
use crate::dataset::neighbours::{as_points, nearest_to};
use crate::dataset::{Dataset, Tracks, builtin};
use crate::run::Trainer;
use crate::run::fixtures::{config, device, options, trained};

/// Mean height over the floor of the built-in scene, or below it, of the surfels of `trainer` next to a point on the floor.
fn mean_distance_from_floor(trainer: &Trainer) -> f64 {
    let points = &trainer.dataset().points.positions;
    let surfels = trainer.scene().surfels;
    let positions = as_points(&surfels.positions);
    let near = nearest_to(positions, points, 1);
    let on_floor = positions.iter().zip(&near).filter(|(_, near)| points[near[0].0 as usize][2].abs() < 0.01);
    let distances: Vec<f64> = on_floor.map(|(position, _)| f64::from(position[2].abs())).collect();
    assert!(distances.len() > 30, "{} surfels", distances.len());
    distances.iter().sum::<f64>() / distances.len() as f64
}

#[test]
fn surfels_keep_their_distance_to_measured_points() {
    let data = Arc::new(builtin(&options(24, [4, 1], 600)));
    let distance = |lambda: &str| {
        let set = [
            lambda,
            "train.steps=120",
            "refine.budget=1200",
            // surfels stay, however wrong they are
            "refine.surfel_prune_from=15000",
            "optimizer.position_start=1e-3",
            "optimizer.position_end=1e-3",
        ];
        mean_distance_from_floor(&trained(&set, data.clone()))
    };
    let (without, with) = (distance("train.lambda_points=0"), distance("train.lambda_points=10"));
    assert!(with < 0.7 * without, "{with} with the loss, {without} without");
}

#[test]
fn a_run_goes_on_with_the_points_that_its_surfels_are_held_to() {
    let data = Arc::new(builtin(&options(24, [3, 1], 200)));
    let set = ["train.steps=40", "train.lambda_points=1", "refine.budget=300"];
    let begin = || Trainer::new(config(&set), data.clone(), device()).unwrap();
    let whole = goes_on_alike(begin, &data, &[5, 25]);
    assert!(whole.columns["surfel_points"].iter().any(|number| *number != 0.0));
}

#[test]
fn surfels_without_points_are_refused_by_name() {
    let data = Arc::new(builtin(&options(24, [3, 1], 0)));
    let error = Trainer::check(&config(&["train.lambda_points=1"]), &data, &device()).unwrap_err().to_string();
    assert!(error.contains("train.lambda_points") && error.contains("data.points"), "{error}");
}

#[test]
fn random_points_are_left_out_of_all_that_follows() {
    let mut data = builtin(&options(32, [12, 1], 400));
    data.points.seen_by = Tracks::default();
    let points_of = |set: &[&str], data: &Dataset| {
        let trainer = Trainer::new(config(set), Arc::new(data.clone()), device()).unwrap();
        (trainer.dataset().points.positions.len(), trainer.scene().environment.is_some())
    };
    let set = ["train.steps=4", "refine.budget=300"];
    assert_eq!(points_of(&set, &data).0, 400, "measured ones");
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    for position in &mut data.points.positions {
        *position = [0; 3].map(|_| rng.random_range(-1.3..1.3));
    }
    data.points.colours.rotate_left(57);
    assert_eq!(points_of(&set, &data), (0, true), "and nothing says how far anything is");
    assert_eq!(points_of(&["init.method=sfm", set[0], set[1]], &data).0, 400, "asked for");
    let (data, begin) = (Arc::new(data), config(&set));
    goes_on_alike(|| Trainer::new(begin.clone(), data.clone(), device()).unwrap(), &data, &[2]);
}
