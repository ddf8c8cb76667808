//! Scenes at the extremes: everything is finite.

use burn::tensor::Device;
use dpges_core::testing::extremes::{Extreme, Hazard, extreme_of};
use dpges_core::testing::precision::{Deviation, Way, deviations};

/// Every tensor of `extreme` in every way is finite; returns how far each is from f64.
pub fn finite(what: &str, extreme: &Extreme, device: &Device) -> Vec<Deviation> {
    let of = |way| {
        deviations(extreme, way, device)
            .unwrap_or_else(|error| panic!("{what}, {:?}, {way:?} is refused: {error}", extreme.hazards))
    };
    let all: Vec<Deviation> = Way::ALL.into_iter().flat_map(of).collect();
    for found in &all {
        let Deviation { way, tensor, non_finite, .. } = found;
        assert_eq!(*non_finite, 0, "{what}, {:?}, {way:?}: {tensor} is not finite", extreme.hazards);
    }
    all
}

pub fn every_hazard_alone_is_finite(device: Device) {
    for hazard in Hazard::ALL {
        for seed in 0..4 {
            finite(&format!("seed {seed}"), &extreme_of(hazard, seed), &device);
        }
    }
}
