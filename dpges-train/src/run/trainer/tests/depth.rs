//! Depth maps.

use std::sync::Arc;

use super::{STAGES, finished, saved_and_loaded, trainer};
use crate::dataset::{BuiltinOptions, DepthKind, View, builtin, builtin_geometry};
use crate::eval::rendered::Renderer;
use crate::run::Trainer;
use crate::run::fixtures::{config, device};

/// Mean error of depth of the surfels of `trainer` in a training view of the built-in scene.
fn mean_depth_error(trainer: &Trainer, view: &View) -> f64 {
    let scene = trainer.scene();
    let (_, depth) = Renderer::new(&scene, &device()).render_with_depth(&view.camera).unwrap();
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
    let size = BuiltinOptions { width: 32, height: 32, train_views: 6, points: 500, ..Default::default() };
    let error = |kind: Option<DepthKind>| {
        let mut data = builtin(&BuiltinOptions { depth: kind, ..size.clone() });
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
        let mut trainer = Trainer::new(config(&set), Arc::new(data), device()).unwrap();
        while !trainer.is_finished() {
            trainer.step().unwrap();
        }
        let views = &trainer.dataset().train;
        views.iter().map(|view| mean_depth_error(&trainer, view)).sum::<f64>() / views.len() as f64
    };
    let (without, metric) = (error(None), error(Some(DepthKind::Metric)));
    assert!(metric < 0.8 * without, "{metric} with maps, {without} without");
}

#[test]
fn stages_learn_from_depth_maps_and_resume() {
    let folder = tempfile::tempdir().unwrap();
    for kind in [DepthKind::Metric, DepthKind::Relative] {
        let options =
            BuiltinOptions { width: 24, height: 24, train_views: 3, test_views: 1, points: 200, ..Default::default() };
        let data = Arc::new(builtin(&BuiltinOptions { depth: Some(kind), ..options }));
        let whole = finished(Trainer::new(config(&STAGES), data.clone(), device()).unwrap());
        assert!(whole.attributes != finished(trainer(&STAGES)).attributes, "maps change something");
        let mut first = Trainer::new(config(&STAGES), data.clone(), device()).unwrap();
        while first.completed_steps() < 25 {
            first.step().unwrap();
        }
        let checkpoint = saved_and_loaded(&first.checkpoint(), folder.path());
        assert!(finished(Trainer::resume(checkpoint, data, device()).unwrap()) == whole, "{kind:?}");
    }
}
