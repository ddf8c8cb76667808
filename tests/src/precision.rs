//! How far f32 is from f64 at the extremes. [`budget`](crate::budget) says of how many scenes.

use std::collections::BTreeMap;

use dpges_core::testing::extremes::{Extreme, extreme};
use dpges_core::testing::precision::{Deviation, Distribution, Way, conditions, deviations};

use crate::budget::{number, seeds};
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

/// Adds the tensors `found` of a scene unless rounding decides what is in it.
fn add_to(all: &mut Errors, extreme: &Extreme, moves: usize, found: &[Deviation]) {
    if extreme.hazards.iter().any(|hazard| hazard.is_decided_by_rounding()) {
        return;
    }
    let conditions = Way::ALL.into_iter().flat_map(|way| conditions(extreme, way, moves).unwrap());
    for (found, condition) in found.iter().zip(conditions) {
        all.entry((found.way, found.tensor)).or_default().push([found.error, condition]);
    }
}

/// The part of an error beyond the effect of rounding the inputs to f32, which no arithmetic can mend.
fn beyond(factor: f64, [error, condition]: [f64; 2]) -> f64 {
    (error - factor * condition).max(0.0)
}

#[test]
fn many_hazards_are_finite_and_as_close_as_their_condition_lets_them() {
    let (mut all, mut errors) = (Errors::new(), BTreeMap::<&str, Vec<f64>>::new());
    for seed in seeds(SCENES) {
        let extreme = extreme(seed);
        let found = finite(&format!("seed {seed}"), &extreme, &ndarray());
        add_to(&mut all, &extreme, 2, &found);
        for found in found {
            errors.entry(if found.tensor == "image" { "pictures" } else { "gradients" }).or_default().push(found.error);
        }
    }
    for ((way, tensor), errors) in all {
        let worst = errors.iter().map(|&error| beyond(10.0, error)).fold(0.0, f64::max);
        assert!(worst < BEYOND_CONDITION, "{way:?}: {tensor} is off by {worst:.1e} beyond its condition");
    }
    for (what, errors) in errors {
        let Distribution { count, median, largest, .. } = Distribution::of(errors).unwrap();
        println!("{what}: {count} tensors, median {median:.1e}, largest {largest:.1e}");
        assert!(median < 1e-4, "{what}: half of the errors exceed {median}");
    }
}

/// The table of `dpges-core/docs/method/numerics.md`; `DPGES_FUZZ_CASES` says of how many scenes.
#[test]
#[ignore = "prints a table, which takes minutes"]
fn the_table_of_gradients() {
    let count = number("DPGES_FUZZ_CASES").unwrap_or(TABLE_SCENES);
    let mut all = Errors::new();
    for extreme in (0..count).map(extreme) {
        let found: Vec<Deviation> =
            Way::ALL.into_iter().flat_map(|way| deviations(&extreme, way, &ndarray()).unwrap()).collect();
        add_to(&mut all, &extreme, MOVES, &found);
    }
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
