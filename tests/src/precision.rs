//! How far f32 is from f64 at the extremes. [`budget`](crate::budget) says of how many scenes.

use std::collections::BTreeMap;

use dpges_core::testing::extremes::extreme;

use crate::budget::Budget;
use crate::devices::ndarray;
use crate::extremes::finite;

const SCENES: u64 = 200;

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
