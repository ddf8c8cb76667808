//! How far f32 is from f64 at the extremes.
//!
//! `DPGES_FUZZ_CASES` sets the number of scenes (200 unless set).

use std::collections::BTreeMap;

use dpges_core::testing::extremes::extreme;

use crate::devices::{flex, ndarray};
use crate::extremes::{every_hazard_alone_is_finite, finite};

fn scenes() -> u64 {
    let Ok(text) = std::env::var("DPGES_FUZZ_CASES") else { return 200 };
    text.parse().unwrap_or_else(|_| panic!("DPGES_FUZZ_CASES is {text}, expected a whole number"))
}

#[test]
fn every_hazard_alone_is_finite_on_both_backends() {
    every_hazard_alone_is_finite(ndarray());
    every_hazard_alone_is_finite(flex());
}

#[test]
fn many_hazards_are_finite_and_pictures_are_close() {
    let mut errors: BTreeMap<&str, Vec<f64>> = BTreeMap::new();
    for seed in 0..scenes() {
        for found in finite(&format!("seed {seed}"), &extreme(seed), &ndarray()) {
            errors.entry(if found.tensor == "image" { "pictures" } else { "gradients" }).or_default().push(found.error);
        }
    }
    for (what, mut errors) in errors {
        errors.sort_by(f64::total_cmp);
        let median = errors[errors.len() / 2];
        println!("{what}: median {median:.1e}, largest {:.1e}", errors[errors.len() - 1]);
        assert!(median < 1e-4, "{what}: half of the errors exceed {median}");
    }
}
