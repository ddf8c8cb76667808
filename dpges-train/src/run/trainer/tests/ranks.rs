use burn::tensor::Tensor;
use dpges_core::ranks::Ranks;
use dpges_core::testing::ranks::on_ranks;

use super::*;
use crate::device::place::Place;
use crate::run::fixtures::dataset_of;
use crate::run::{StepReport, TrainError};
use crate::stage::{ScreenGradients, StepViews, begin_step};

fn on_rank(set: &[&str], data: Arc<Dataset>, ranks: Arc<dyn Ranks>) -> Trainer {
    Trainer::new(config(set), data, Place { device: device(), ranks }).unwrap()
}

#[test]
fn what_is_not_finite_on_one_rank_holds_all_back() {
    on_ranks(2, |ranks| {
        // nothing is refined before the step
        let until = ["split", "add", "replace", "surfel_prune"].map(|what| format!("refine.{what}_until=0"));
        let set: Vec<&str> =
            ["train.steps=20", "refine.margins_at=[0]"].into_iter().chain(until.iter().map(String::as_str)).collect();
        let mut trainer = after(on_rank(&set, dataset(), ranks.clone()), 3);
        let before = trainer.checkpoint().attributes;
        if ranks.rank() == 1 {
            trainer.context.config.train.lambda_dssim = 1e39;
        }
        let error = trainer.step().unwrap_err();
        match error {
            TrainError::Loss { step: 4, .. } => assert_eq!(ranks.rank(), 1),
            TrainError::Step { step: 4, ref source, .. } => {
                assert!(ranks.is_first() && source.to_string().contains("another rank"), "{error}");
            }
            other => panic!("{other}"),
        }
        assert!(trainer.checkpoint().attributes == before, "parameters have learnt from it");
    });
}

#[test]
fn a_rank_that_has_something_else_is_named() {
    let errors = on_ranks(3, |ranks| {
        let mut trainer = on_rank(&["train.steps=20"], dataset(), ranks.clone());
        trainer.step().unwrap();
        trainer.check_ranks().unwrap();
        if ranks.rank() == 2 {
            let positions = &mut trainer.stage.parameters().surfels.columns.positions;
            let moved: Tensor<2> = positions.raw() + 1e-3;
            positions.set_tensor(moved);
        }
        trainer.check_ranks().unwrap_err().to_string()
    });
    assert!(errors.iter().all(|error| error.contains("step 1: rank 2")), "{errors:?}");
}

/// All that a stage of blended Gaussians learns and notes down, without noise.
const CONTROLLED: [&str; 7] = [
    "train.method=3dgs",
    "train.steps=60",
    "train.exposure=on",
    "train.poses=on",
    "optimizer.pose_from=0",
    "model.environment=sh1",
    "density.gradient_threshold=1e-7",
];

/// The state of each of `count` ranks after a step on `views` views in all.
fn after_a_step(count: usize, views: usize) -> Vec<Checkpoint> {
    on_ranks(count, |ranks| {
        let mut trainer = on_rank(&CONTROLLED, dataset_of(views), ranks);
        trainer.step().unwrap();
        trainer.check_ranks().unwrap();
        trainer.checkpoint()
    })
}

#[test]
fn a_batch_of_one_view_learns_as_that_view_at_the_root_of_as_many_rates() {
    let data = dataset_of(1);
    let start = Trainer::new(config(&CONTROLLED), data, device()).unwrap().checkpoint();
    let alone = after_a_step(1, 1).remove(0);
    for (count, found) in
        [2, 3].into_iter().flat_map(|count| after_a_step(count, 1).into_iter().map(move |of| (count, of)))
    {
        assert_eq!(found.completed_steps(), count);
        for name in ["gaussians.positions", "gaussians.log_scales", "environment"] {
            let raw = |of: &Checkpoint| of.attributes[name].raw.clone();
            let (start, alone, found) = (raw(&start), raw(&alone), raw(&found));
            assert!(alone != start, "{name} has not learnt");
            for ((start, alone), found) in start.iter().zip(alone).zip(found) {
                let expected = start + (count as f32).sqrt() * (alone - start);
                assert!(
                    (found - expected).abs() < 1e-5 + 1e-4 * (found - start).abs(),
                    "{name}: {found}, not {expected}"
                );
            }
        }
    }
}

#[test]
fn what_the_views_of_a_step_want_is_added_up() {
    let of_view = |view: usize| {
        let mut trainer = Trainer::new(config(&CONTROLLED), dataset_of(2), device()).unwrap();
        let Trainer { stage, context, .. } = &mut trainer;
        let report = StepReport::begin(1, stage.plan(), view, Vec::new());
        let begun = begin_step(&mut **stage, context, report, StepViews::one(view)).unwrap();
        begun.learn(&mut **stage, context).unwrap().settle().unwrap();
        trainer.checkpoint()
    };
    let alone = [0, 1].map(of_view);
    for found in after_a_step(2, 2) {
        for name in ScreenGradients::NAMES {
            let [first, second] = alone.each_ref().map(|of| &of.columns[name]);
            assert!(first != second, "{name} does not tell views apart");
            for ((first, second), found) in first.iter().zip(second).zip(&found.columns[name]) {
                let expected = first + second;
                assert!((found - expected).abs() <= 1e-5 * expected.abs(), "{name}: {found}, not {expected}");
            }
        }
        // each rank has learnt of the other's view
        assert!(found.attributes["exposure"].raw.as_chunks::<6>().0.iter().all(|row| row.iter().any(|&of| of != 0.0)));
        let waiting: Vec<[f32; 2]> =
            found.columns["pose_gradients"].as_chunks::<8>().0.iter().map(|row| [row[0], row[1]]).collect();
        let mut views: Vec<f32> = waiting.iter().map(|of| of[1]).collect();
        views.sort_by(f32::total_cmp);
        assert!(views == [0.0, 1.0] && waiting.iter().all(|of| of[0] == 2.0), "{waiting:?}");
    }
}

#[test]
fn a_stage_of_several_views_a_step_ends_where_it_ends_with_one() {
    let reports = on_ranks(2, |ranks| {
        let set = ["train.steps=15", "stages.gaussians=0.6", "stages.gaussians_by=mcmc", "refine.budget=500"];
        let mut trainer = on_rank(&set, dataset(), ranks);
        let mut steps = Vec::new();
        while !trainer.is_finished() {
            steps.extend(trainer.step().unwrap().map(|report| report.step));
        }
        steps
    });
    assert!(reports.iter().all(|steps| steps == &[2, 4, 6, 8, 9, 10, 11, 12, 13, 14, 15]), "{reports:?}");
}
