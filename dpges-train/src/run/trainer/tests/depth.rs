//! Depth maps.

use std::sync::Arc;

use super::{STAGES, finished, goes_on_alike, trainer};
use crate::dataset::{BuiltinOptions, DepthKind, View, builtin, builtin_geometry};
use crate::eval::rendered::TrainingRenderer;
use crate::run::Trainer;
use crate::run::fixtures::{config, device, options, trained};

/// Mean error of depth of the surfels of `trainer` in a training view of the built-in scene.
fn mean_depth_error(trainer: &Trainer, view: &View) -> f64 {
    let scene = trainer.scene();
    let (_, depth) = TrainingRenderer::new(&scene, &device()).render_with_depth(&view.camera).unwrap();
    let (truth, _) = builtin_geometry(&view.camera);
    let shown: Vec<f64> = depth
        .iter()
        .zip(&truth)
        .filter(|(z, _)| **z > 0.0)
        .map(|(z, truth)| f64::from((z / truth - 1.0).abs()))
        .collect();
    assert!(shown.len() > 200, "{} pixels", shown.len());
    shown.iter().sum::<f64>() / shown.len() as f64
}

#[test]
fn depth_maps_bring_surfels_to_their_depth() {
    let error = |depth: Option<DepthKind>| {
        let mut data = builtin(&BuiltinOptions { depth, ..options(32, [6, 6], 500) });
        // along the first axis by up to 0.15
        let positions = data.points.positions.iter_mut().enumerate();
        positions.for_each(|(at, position)| position[0] += 0.3 * ((at * 37 % 101) as f32 / 101.0 - 0.5));
        let set = [
            "train.steps=150",
            "refine.budget=1200",
            "train.lambda_depth_maps=2",
            "train.depth_maps_decay=1",
            // surfels stay, however wrong they are
            "refine.surfel_prune_from=15000",
            "optimizer.position_start=1e-3",
            "optimizer.position_end=1e-3",
        ];
        let trainer = trained(&set, Arc::new(data));
        let views = &trainer.dataset().train;
        views.iter().map(|view| mean_depth_error(&trainer, view)).sum::<f64>() / views.len() as f64
    };
    let (without, metric) = (error(None), error(Some(DepthKind::Metric)));
    assert!(metric < 0.8 * without, "{metric} with maps, {without} without");
}

#[test]
fn stages_learn_from_depth_maps_and_resume() {
    for kind in [DepthKind::Metric, DepthKind::Relative] {
        let data = Arc::new(builtin(&BuiltinOptions { depth: Some(kind), ..options(24, [3, 1], 200) }));
        let begin = || Trainer::new(config(&STAGES), data.clone(), device()).unwrap();
        let whole = goes_on_alike(begin, &data, &[25]);
        assert!(whole.attributes != finished(trainer(&STAGES)).attributes, "maps change something");
    }
}
