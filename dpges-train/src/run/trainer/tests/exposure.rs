//! Colour corrections of photographs.

use std::sync::Arc;

use crate::dataset::{BuiltinOptions, View, builtin};
use crate::eval::rendered::TrainingRenderer;
use crate::eval::{Evaluation, Measures, evaluate_each};
use crate::run::fixtures::{device, options, trained};
use crate::views::exposure::Correction;

#[test]
fn exposures_are_found_and_compensated() {
    let options = options(32, [8, 4], 400);
    let plain = builtin(&options);
    let changed = Arc::new(builtin(&BuiltinOptions { exposure_stops: 1.0, ..options }));
    let learnt = |exposure: &str| {
        let set = ["train.steps=400", "refine.budget=1500", "optimizer.exposure=0.02", exposure];
        let trainer = trained(&set, changed.clone());
        let scene = trainer.scene();
        let renderer = TrainingRenderer::new(&scene, &device());
        let measures = Measures { fitted: true, ..Measures::BASIC };
        let evaluation: dpges_core::Result<Evaluation> =
            evaluate_each(&renderer, &scene, &changed.test, measures, |_, _| Ok(()));
        (evaluation.unwrap().fitted.psnr_fitted.unwrap(), trainer.view_corrections().exposure)
    };
    let (with, found) = learnt("train.exposure=auto");
    let (without, none) = learnt("train.exposure=off");
    assert!(with > without && none.is_none(), "{with} with, {without} dB without");

    // by how much each photograph is brighter than the scene, and than the others
    let brightness =
        |view: &View| f64::from(view.picture().unwrap().planes().iter().sum::<f32>() / (3.0 * 32.0 * 32.0));
    let found = found.expect("exposures differ by more than auto takes");
    let pairs = changed.train.iter().zip(&plain.train);
    let (truth, learnt): (Vec<f64>, Vec<f64>) = pairs
        .map(|(changed, plain)| {
            let (scene, Correction { gain, offset }) = (brightness(plain), found[&changed.name]);
            let shown = (0..3).map(|channel| gain[channel] * scene + offset[channel]).sum::<f64>() / 3.0;
            ((brightness(changed) / scene).ln(), (shown / scene).ln())
        })
        .unzip();
    let centred = |values: &[f64]| {
        let mean = values.iter().sum::<f64>() / values.len() as f64;
        values.iter().map(|value| value - mean).collect::<Vec<f64>>()
    };
    let (truth, learnt) = (centred(&truth), centred(&learnt));
    let wrong: f64 = truth.iter().zip(&learnt).map(|(a, b)| (a - b).powi(2)).sum();
    let all: f64 = truth.iter().map(|a| a.powi(2)).sum();
    assert!(wrong < 0.25 * all, "{truth:?} {learnt:?}");
}
