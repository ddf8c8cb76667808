//! How far f32 is from f64 at the extremes. [`budget`](crate::budget) says of how many scenes.

use std::collections::BTreeMap;

use dpges_core::testing::extremes::{Extreme, extreme};
use dpges_core::testing::precision::{Distribution, Way, conditions, deviations};

use crate::budget::{Budget, number};
use crate::devices::ndarray;
use crate::extremes::finite;

const SCENES: u64 = 200;
/// Scenes of the table, and moves of the inputs of each.
const TABLE_SCENES: u64 = 10_000;
const MOVES: usize = 8;
/// Beyond 10 times its condition no gradient may be off by more.
const BEYOND_CONDITION: f64 = 5e-3;

/// Errors of one tensor of many scenes, and their conditions.
type Errors = BTreeMap<(Way, &'static str), Vec<[f64; 2]>>;

/// Adds the tensors of a scene unless rounding decides what is in it.
fn measure(extreme: &Extreme, moves: usize, all: &mut Errors) {
    if extreme.hazards.iter().any(|hazard| hazard.is_decided_by_rounding()) {
        return;
    }
    for way in Way::ALL {
        let condition = conditions(extreme, way, moves).unwrap();
        for (found, condition) in deviations(extreme, way, &ndarray()).unwrap().iter().zip(condition) {
            all.entry((way, found.tensor)).or_default().push([found.error, condition]);
        }
    }
}

/// The part of an error beyond the effect of rounding the inputs to f32, which no arithmetic can mend.
fn beyond(factor: f64, [error, condition]: [f64; 2]) -> f64 {
    (error - factor * condition).max(0.0)
}

#[test]
fn gradients_are_as_close_as_their_condition_lets_them() {
    let mut all = Errors::new();
    Budget::start(SCENES).seeds().for_each(|seed| measure(&extreme(seed), 2, &mut all));
    for ((way, tensor), errors) in all {
        let worst = errors.iter().map(|&error| beyond(10.0, error)).fold(0.0, f64::max);
        assert!(worst < BEYOND_CONDITION, "{way:?}: {tensor} is off by {worst:.1e} beyond its condition");
    }
}

/// The table of `dpges-core/docs/method/numerics.md`; `DPGES_FUZZ_CASES` says of how many scenes.
#[test]
#[ignore = "prints a table, which takes minutes"]
fn the_table_of_gradients() {
    let count = number("DPGES_FUZZ_CASES").unwrap_or(TABLE_SCENES);
    let mut all = Errors::new();
    (0..count).for_each(|seed| measure(&extreme(seed), MOVES, &mut all));
    println!("| tensor | scenes | error: 99.9 % | largest | condition: 99.9 % | largest | beyond: 99.9 % | largest |");
    println!("|---|---|---|---|---|---|---|---|");
    for ((way, tensor), errors) in &all {
        let of = |value: &dyn Fn([f64; 2]) -> f64| {
            let Distribution { nearly_all, largest, .. } =
                Distribution::of(errors.iter().map(|&error| value(error)).collect()).unwrap();
            format!("{nearly_all:.1e} | {largest:.1e}")
        };
        let (error, condition) = (of(&|[error, _]| error), of(&|[_, condition]| condition));
        let beyond = of(&|error| beyond(1.0, error));
        println!("| {}: {tensor} | {} | {error} | {condition} | {beyond} |", way.name(), errors.len());
    }
}

#[test]
fn many_hazards_are_finite_and_pictures_are_close() {
    let mut errors: BTreeMap<&str, Vec<f64>> = BTreeMap::new();
    for seed in Budget::start(SCENES).seeds() {
        for found in finite(&format!("seed {seed}"), &extreme(seed), &ndarray()) {
            errors.entry(if found.tensor == "image" { "pictures" } else { "gradients" }).or_default().push(found.error);
        }
    }
    for (what, mut errors) in errors {
        errors.sort_by(f64::total_cmp);
        let median = errors[errors.len() / 2];
        println!("{what}: {} tensors, median {median:.1e}, largest {:.1e}", errors.len(), errors[errors.len() - 1]);
        assert!(median < 1e-4, "{what}: half of the errors exceed {median}");
    }
}
