//! Runs on several ranks, which are threads here.

use std::path::Path;

use dpges_core::ranks::Ranks;
use dpges_core::scene::SceneData;
use dpges_core::testing::ranks::on_ranks;

use super::checkpoint::Checkpoint;
use super::fixtures::{config, dataset, dataset_of, device};
use super::*;
use crate::device::place::Place;
use crate::eval::evaluate;

/// All kinds of refinement, environment, poses, and what has to be added up over ranks.
const ALL: [&str; 12] = [
    "train.steps=60",
    "train.poses=on",
    "train.exposure=on",
    "train.lambda_opacity=0.01",
    "train.lambda_gaussian_scale=0.01",
    "model.environment=sh1",
    "model.sampling_limit=0.3",
    "optimizer.pose_from=0",
    "refine.budget=700",
    "refine.new_gaussians=copies",
    "train.evaluate_every=20",
    "train.checkpoint_every=10",
];

fn place(ranks: Arc<dyn Ranks>) -> Place {
    Place { device: device(), ranks }
}

/// The state of every rank after `steps` steps, and the scene.
fn trained(set: &[&str], count: usize, steps: usize) -> Vec<(Checkpoint, SceneData)> {
    on_ranks(count, |ranks| {
        let mut trainer = Trainer::new(config(set), dataset(), place(ranks)).unwrap();
        (0..steps).for_each(|_| drop(trainer.step().unwrap()));
        trainer.check_ranks().unwrap();
        (trainer.checkpoint(), trainer.scene())
    })
}

/// Whole runs on `count` ranks, all with the same scene.
fn outcomes(set: &[&str], data: &Arc<Dataset>, count: usize) -> Vec<Outcome> {
    let outcomes =
        on_ranks(count, |ranks| Run::new(config(set), Arc::clone(data), place(ranks)).unwrap().train(&mut ()).unwrap());
    assert!(outcomes.iter().all(|outcome| outcome.scene == outcomes[0].scene));
    outcomes
}

fn largest_difference(a: &[f32], b: &[f32]) -> f32 {
    assert_eq!(a.len(), b.len());
    a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max)
}

#[test]
fn few_steps_on_several_ranks_are_those_of_one() {
    let (single, alone) = trained(&ALL, 1, 5).remove(0);
    for count in [2, 3] {
        let parts = trained(&ALL, count, 5);
        for (checkpoint, scene) in &parts {
            assert_eq!(scene, &parts[0].1);
            let own = checkpoint.attributes["gaussians.positions"].count;
            assert!(own.abs_diff(scene.gaussians.len() / count) <= 1 + scene.gaussians.len() / 20, "{own}");
        }
        let scene = &parts[0].1;
        assert!(largest_difference(&scene.gaussians.positions, &alone.gaussians.positions) < 1e-3);
        assert!(largest_difference(&scene.gaussians.opacities, &alone.gaussians.opacities) < 1e-3);
        assert!(largest_difference(&scene.surfels.positions, &alone.surfels.positions) < 1e-3);
        let rows = |checkpoint: &Checkpoint, name: &str| checkpoint.attributes[name].raw.clone();
        for name in ["poses", "environment", "exposure"] {
            let (found, expected) = (rows(&parts[1].0, name), rows(&single, name));
            assert!(expected.iter().any(|&number| number != 0.0), "{name} has not learnt");
            assert!(largest_difference(&found, &expected) < 1e-3, "{name}: {found:?}, expected {expected:?}");
        }
    }
}

#[test]
fn the_same_ranks_give_the_same_bytes() {
    let (first, second) = (trained(&ALL, 2, 40), trained(&ALL, 2, 40));
    assert!(first == second);
    assert_eq!(first[0].1, first[1].1);
    let primitives = first[0].1.surfels.len() + first[0].1.gaussians.len();
    assert!((600..=700).contains(&primitives), "{primitives}: the budget is that of all ranks");
}

#[test]
fn whole_trainings_are_within_chance_of_one_another() {
    let data = dataset();
    let psnr = |count: usize| {
        let set = ["train.steps=150", "refine.budget=700", "train.evaluate_every=0"];
        let outcomes = outcomes(&set, &data, count);
        let scores: Vec<f64> = outcomes.iter().map(|outcome| outcome.evaluation.as_ref().unwrap().psnr).collect();
        assert!(scores.iter().all(|&score| score == scores[0]), "{scores:?}");
        // of the gathered scene on one device
        let whole = evaluate(&outcomes[0].scene, &data.test, &device()).unwrap().psnr;
        assert!((whole - scores[0]).abs() < 1e-3);
        evaluate(&outcomes[0].scene, &data.train, &device()).unwrap().psnr
    };
    let found = [1, 2, 3].map(psnr);
    assert!(found.iter().all(|psnr| (psnr - found[0]).abs() < 0.5), "{found:?}");
}

#[test]
fn an_automatic_budget_decides_alike_on_all_ranks() {
    let set = ["train.steps=100", "refine.budget=auto", "refine.split_until=0"];
    outcomes(&set, &dataset_of(9), 2);
}

#[test]
fn stages_of_blended_gaussians_are_the_same_on_all_ranks() {
    // 16 steps of 40, two at once
    let set = ["train.steps=40", "stages.gaussians=0.4", "stages.gaussians_by=mcmc", "refine.budget=500"];
    let parts = trained(&set, 2, 6);
    assert_eq!(parts[0].1, parts[1].1);
    let parts = trained(&set, 2, 8 + 24);
    assert_eq!(parts[0].1, parts[1].1);
    let all = parts[0].1.gaussians.len();
    assert!(parts.iter().all(|(part, _)| part.attributes["gaussians.positions"].count < all));
}

fn in_folder(set: &[&str], path: &Path, count: usize, stop: Option<usize>) {
    on_ranks(count, |ranks| {
        let folder = RunFolder::new(path);
        let run = Run::new(config(set), dataset(), place(ranks)).unwrap();
        let mut run = run.overwrite(folder, Origin::new("builtin", "cpu")).unwrap();
        train_until(&mut run, stop);
    });
}

fn resumed(path: &Path, count: usize, stop: Option<usize>) -> usize {
    let from = on_ranks(count, |ranks| {
        let saved = SavedRun::open(RunFolder::new(path)).unwrap();
        let from = saved.completed_steps();
        train_until(&mut Run::resume(saved, dataset(), place(ranks)).unwrap(), stop);
        from
    });
    from[0]
}

/// Only the first rank is asked to stop.
struct StopsAfter(Option<usize>, usize);

impl Observer for StopsAfter {
    fn step(&mut self, report: &StepReport, _: f64) {
        self.1 = report.step;
    }

    fn should_stop(&mut self) -> bool {
        self.0 == Some(self.1)
    }
}

fn train_until(run: &mut Run, stop: Option<usize>) {
    let own = stop.filter(|_| run.trainer().ranks().is_first());
    match (run.train(&mut StopsAfter(own, 0)), stop) {
        (Ok(_), None) => {}
        (Err(RunError::Stopped { step, .. }), Some(stop)) => assert_eq!(step, stop),
        (other, _) => panic!("{:?}", other.err()),
    }
}

fn names(path: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(path).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap());
    let mut names: Vec<String> = entries.filter(|name| name.starts_with("checkpoint")).collect();
    names.sort();
    names
}

fn scene(path: &Path) -> Vec<u8> {
    std::fs::read(path.join("scene.safetensors")).unwrap()
}

#[test]
fn a_run_goes_on_with_any_number_of_ranks() {
    let (whole, stopped) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    in_folder(&ALL, whole.path(), 2, None);
    in_folder(&ALL, stopped.path(), 2, Some(25));
    let [a, b, c, d] = ["0002_0_of_2", "0002_1_of_2", "0003_0_of_2", "0003_1_of_2"]
        .map(|part| format!("checkpoint_{part}.safetensors"));
    assert_eq!(names(stopped.path()), ["checkpoint.json".to_owned(), a, b, c, d]);
    let copy = |to: &Path| {
        std::fs::create_dir_all(to.join("pictures")).unwrap();
        for entry in std::fs::read_dir(stopped.path()).unwrap().map(|entry| entry.unwrap().path()) {
            if entry.is_file() {
                std::fs::copy(&entry, to.join(entry.file_name().unwrap())).unwrap();
            }
        }
    };
    for count in [1, 2, 3] {
        let folder = tempfile::tempdir().unwrap();
        copy(folder.path());
        assert_eq!(resumed(folder.path(), count, None), 25);
        // as many ranks as before do the same again
        assert!((scene(folder.path()) == scene(whole.path())) == (count == 2), "{count} ranks");
        let kept = names(folder.path());
        match count {
            1 => assert_eq!(kept, ["checkpoint.safetensors"]),
            _ => assert!(kept.len() == 1 + 2 * count && kept[0] == "checkpoint.json", "{kept:?}"),
        }
    }
    // a part that is not whole: the generation before
    let folder = tempfile::tempdir().unwrap();
    copy(folder.path());
    std::fs::write(folder.path().join("checkpoint_0003_1_of_2.safetensors"), "half").unwrap();
    assert_eq!(resumed(folder.path(), 3, Some(30)), 20);
    for name in names(folder.path()).iter().filter(|name| name.ends_with(".safetensors")) {
        std::fs::write(folder.path().join(name), "half").unwrap();
    }
    let error = SavedRun::open(RunFolder::new(folder.path())).unwrap_err().to_string();
    assert!(error.contains("no generation is whole") && error.contains("checkpoint_"), "{error}");
    // and from one rank to two
    let folder = tempfile::tempdir().unwrap();
    in_folder(&ALL, folder.path(), 1, Some(15));
    assert_eq!(resumed(folder.path(), 2, Some(25)), 15);
    assert!(!folder.path().join("checkpoint.safetensors").exists());
    assert_eq!(resumed(folder.path(), 1, None), 25);
    assert_eq!(names(folder.path()), ["checkpoint.safetensors"]);
}

#[test]
fn blended_stages_whose_views_are_shared_out_go_on_with_any_number_of_ranks() {
    let mut set = ALL.to_vec();
    set.extend(["train.method=3dgs", "density.gradient_threshold=1e-7", "train.checkpoint_every=7"]);
    let whole = tempfile::tempdir().unwrap();
    in_folder(&set, whole.path(), 2, None);
    for count in [1, 2, 3] {
        let folder = tempfile::tempdir().unwrap();
        in_folder(&set, folder.path(), 2, Some(26));
        assert_eq!(resumed(folder.path(), count, None), 26);
        assert!((scene(folder.path()) == scene(whole.path())) == (count == 2), "{count} ranks");
    }
}

/// A batch takes fewer and larger steps: the results differ, and no rank has half the quality.
#[test]
fn trainings_whose_views_are_shared_out_are_as_good_but_for_the_size_of_batches() {
    let data = dataset();
    for method in ["train.method=mcmc", "train.method=3dgs"] {
        let psnr = |count: usize| {
            let set = [method, "train.steps=300", "refine.budget=700", "train.evaluate_every=0"];
            evaluate(&outcomes(&set, &data, count)[0].scene, &data.train, &device()).unwrap().psnr
        };
        let found = [1, 2, 3].map(psnr);
        println!("{method}: {found:?}");
        assert!(found.iter().all(|psnr| (psnr - found[0]).abs() < 1.5), "{method}: {found:?}");
    }
}
