//! Scenes at the extremes: everything is finite.

use burn::tensor::{DType, Device};
use dpges_core::ops::peel::PeelOptions;
use dpges_core::render::{RenderOptions, render};
use dpges_core::scene::{Footprint, Peeling};
use dpges_core::testing::extremes::{Extreme, Hazard, extreme, extreme_of};
use dpges_core::testing::golden::values;
use dpges_core::testing::precision::{Deviation, Way, conditions, deviations};

use crate::poisoned::scene;

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

pub fn every_hazard_alone_is_finite(device: &Device) {
    for hazard in Hazard::ALL {
        for seed in 0..4 {
            finite(&format!("seed {seed}"), &extreme_of(hazard, seed), device);
        }
    }
}

/// Needles much longer than the picture and much thinner than a pixel, whose axes are parallel in the image but for the last
/// digits of an f32. Without products in place of differences, gradients are off by up to 1,400 times their size.
const NEEDLES: [u64; 10] = [496, 1482, 1627, 4033, 4814, 5648, 6457, 8287, 9285, 9416];

/// Gradients are off by no more than rounding the inputs moves them, and a little.
pub fn gradients_of_needles_are_close(device: &Device) {
    for seed in NEEDLES {
        let extreme = extreme(seed);
        for way in [Way::Peeled, Way::Ellipsoids, Way::PlainEllipsoids] {
            let condition = conditions(&extreme, way, 4).unwrap();
            for (found, condition) in deviations(&extreme, way, device).unwrap().iter().zip(condition) {
                let Deviation { tensor, error, .. } = found;
                let bound = 1e-4 + 10.0 * condition;
                assert!(*error < bound, "seed {seed}, {way:?}: {tensor} is off by {error:.1e}, not {bound:.1e}");
            }
        }
    }
}

/// Surfels so steep that every fragment is opaque: no pixel is in between.
pub fn transmittances_of_exactly_0_and_1_are_finite(device: &Device) {
    for layer_count in [1, 3] {
        let peel =
            PeelOptions { layer_count, modulation: 1e30, footprint: Footprint::Kernel, peeling: Peeling::Continuous };
        let scene = scene();
        let (surfels, gaussians) = scene.tensors(device, DType::F32);
        let options = RenderOptions { peel, ..RenderOptions::default() };
        let rendered = render(&surfels, &gaussians, &scene.camera, &options).unwrap();
        let behind = values(&rendered.seen.behind_all());
        let [closed, open] = [0.0, 1.0].map(|exactly| behind.iter().filter(|&&t| t == exactly).count());
        assert!(closed > 10 && open > 10, "{closed} pixels are closed and {open} open");
        assert_eq!(closed + open, behind.len(), "transmittances between 0 and 1");
        let extreme = Extreme { seed: 23, hazards: vec![Hazard::Steep], scene, peel, extent: 1.0 };
        finite(&format!("{layer_count} layers"), &extreme, device);
    }
}
