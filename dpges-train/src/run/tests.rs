use std::collections::BTreeMap;
use std::path::Path;

use dpges_core::scene::{Rendering, SceneData};

use super::checkpoint::CheckpointError;
use super::fixtures::{config, dataset, dataset_of, device, fisheye_dataset};
use super::folder::{RunFolderError, read_json};
use super::*;
use crate::config::StagePlan;
use crate::eval::{EvalReport, evaluate};
use crate::views::exposure::Correction;

/// Two stages, evaluations and a checkpoint on the way.
const SHORT: [&str; 6] = [
    "train.steps=30",
    "stages.surfels=0.4",
    "stages.surfel_opacity=0.05",
    "refine.budget=500",
    "train.evaluate_every=8",
    "train.checkpoint_every=10",
];

fn run(set: &[&str]) -> Run {
    Run::new(config(set), dataset(), device()).unwrap()
}

fn in_folder(set: &[&str], path: &Path) -> Run {
    written(run(set), path)
}

fn written(run: Run, path: &Path) -> Run {
    run.write_to(RunFolder::new(path), Origin::new("builtin", "cpu")).unwrap()
}

/// On nine views, in a folder if there is one.
fn on_nine(set: &[&str], folder: Option<&Path>) -> Run {
    let run = Run::new(config(set), dataset_of(9), device()).unwrap();
    match folder {
        Some(path) => written(run, path),
        None => run,
    }
}

fn error<T>(result: Result<T, RunError>) -> RunError {
    result.err().expect("it fails")
}

/// Writes down what it is told; stops after step `stop`.
#[derive(Default)]
struct Notes {
    stop: Option<usize>,
    fails_after: Option<usize>,
    steps: Vec<usize>,
    evaluated: Vec<usize>,
    validated: Vec<(usize, Verdict)>,
    ended: Vec<(String, usize)>,
    saved: Vec<usize>,
    wanted_after: Option<usize>,
    scenes: Vec<(usize, SceneData)>,
}

impl Observer for Notes {
    fn step(&mut self, report: &StepReport, seconds: f64) {
        assert!(report.loss.is_finite() && seconds > 0.0);
        self.steps.push(report.step);
    }

    fn evaluated(&mut self, step: usize, evaluation: &Evaluation) {
        assert_eq!(evaluation.views.len(), 1);
        self.evaluated.push(step);
    }

    fn validated(&mut self, step: usize, psnr: f64, verdict: Verdict) {
        assert!(psnr > 0.0);
        self.validated.push((step, verdict));
    }

    fn stage_ended(&mut self, stage: StagePlan, scene: &SceneData) {
        self.ended.push((stage.kind.to_string(), scene.gaussians.len()));
    }

    fn saved(&mut self, step: usize) {
        self.saved.push(step);
    }

    fn wants_scene(&mut self) -> bool {
        self.wanted_after.is_some() && self.steps.last().copied() == self.wanted_after
    }

    fn scene(&mut self, step: usize, scene: SceneData) {
        self.scenes.push((step, scene));
    }

    fn should_stop(&mut self) -> bool {
        self.steps.last().copied() == self.stop
    }

    fn device_failure(&mut self) -> Option<String> {
        let failed = self.fails_after.is_some_and(|step| self.steps.last().is_some_and(|&last| last >= step));
        failed.then(|| "the device is lost".to_owned())
    }
}

#[test]
fn a_run_in_memory_trains_evaluates_and_leaves_a_scene_to_save() {
    let folder = tempfile::tempdir().unwrap();
    let mut run = run(&SHORT);
    let mut losses = Vec::new();
    let outcome = run.train(&mut |report: &StepReport| losses.push(report.loss)).unwrap();
    assert!(losses.len() == 30 && run.trainer().is_finished());
    assert!(run.folder().is_none() && run.saved_step().is_none() && outcome.seconds > 0.0);
    let evaluation = outcome.evaluation.unwrap();
    assert_eq!(
        (evaluation.surfels, evaluation.gaussians),
        (outcome.scene.surfels.len(), outcome.scene.gaussians.len())
    );
    let path = folder.path().join("scene.safetensors");
    outcome.scene.save(&path).unwrap();
    assert_eq!(SceneData::load(&path).unwrap(), outcome.scene);
}

#[test]
fn scenes_are_learnt_through_a_fisheye_lens() {
    let data = fisheye_dataset();
    let psnr = |run: &Run| evaluate(&run.trainer().scene(), &data.train, &device()).unwrap().psnr;
    for (method, steps, gain) in [("dpges", "150", 1.5), ("3dgs", "60", 0.0), ("mcmc", "60", 0.0)] {
        let set = [format!("train.method={method}"), format!("train.steps={steps}"), "refine.budget=1500".to_owned()];
        let config = config(&set.each_ref().map(String::as_str));
        let mut run = Run::new(config, Arc::clone(&data), device()).unwrap();
        let before = psnr(&run);
        let outcome = run.train(&mut |_: &StepReport| ()).unwrap();
        let after = psnr(&run);
        assert!(after > before + gain, "{method}: {before:.2} dB before, {after:.2} dB after");
        assert!(outcome.evaluation.is_some_and(|evaluation| evaluation.psnr > 5.0), "{method}");
    }
}

#[test]
fn discs_and_lenses_do_not_go_together() {
    for set in [&["train.method=2dgs"], &["stages.surfels=0.4"]] {
        let message = error(Run::new(config(set), fisheye_dataset(), device())).to_string();
        for part in ["discs", "lens", "train_000", "data.undistort"] {
            assert!(message.contains(part), "{message}");
        }
    }
    // nor where a lens took but a view that judges
    let mut mixed = (*dataset()).clone();
    mixed.test[0] = fisheye_dataset().test[0].clone();
    let message = error(Run::new(config(&["train.method=2dgs"]), Arc::new(mixed), device())).to_string();
    assert!(message.contains("discs") && message.contains("`test_000`"), "{message}");
}

#[test]
fn an_observer_is_told_of_everything() {
    let folder = tempfile::tempdir().unwrap();
    let mut notes = Notes::default();
    in_folder(&SHORT, &folder.path().join("run")).train(&mut notes).unwrap();
    assert_eq!(notes.steps, (1..=30).collect::<Vec<_>>());
    assert_eq!(notes.evaluated, [8, 12, 16, 24, 30], "on the way, at the end of a stage and of the run");
    assert_eq!(notes.saved, [10, 12, 20, 30]);
    assert!(notes.ended.len() == 1 && notes.ended[0].0 == "2dgs" && notes.ended[0].1 > 0, "{:?}", notes.ended);
}

#[test]
fn an_observer_sees_the_scene_when_it_asks_and_changes_nothing_by_it() {
    let whole = run(&SHORT).train(&mut ()).unwrap();
    let mut notes = Notes { wanted_after: Some(14), ..Notes::default() };
    assert!(run(&SHORT).train(&mut notes).unwrap().scene == whole.scene);
    let [(14, scene)] = &notes.scenes[..] else { panic!("{} scenes", notes.scenes.len()) };
    assert!(!scene.surfels.is_empty() && *scene != whole.scene);
}

#[test]
fn an_observer_stops_a_run_that_then_goes_on_to_the_same_scene() {
    let whole = run(&SHORT).train(&mut ()).unwrap();
    let mut run = run(&SHORT);
    for stop in [5, 12, 20] {
        let stopped = run.train(&mut Notes { stop: Some(stop), ..Notes::default() });
        assert!(matches!(stopped, Err(RunError::Stopped { step, steps: 30 }) if step == stop));
    }
    assert!(run.train(&mut ()).unwrap().scene == whole.scene);
}

#[test]
fn a_run_in_a_folder_is_resumed_to_identical_bytes() {
    let at = tempfile::tempdir().unwrap();
    let (whole, parts) = (at.path().join("whole"), at.path().join("parts"));
    in_folder(&SHORT, &whole).train(&mut ()).unwrap();
    error(in_folder(&SHORT, &parts).train(&mut Notes { stop: Some(7), ..Notes::default() }));
    for stop in [12, 23] {
        let saved = SavedRun::open(RunFolder::new(&parts)).unwrap();
        assert!(saved.config() == &config(&SHORT) && saved.origin() == &Origin::new("builtin", "cpu"));
        let mut run = Run::resume(saved, dataset(), device()).unwrap();
        error(run.train(&mut Notes { stop: Some(stop), ..Notes::default() }));
        assert_eq!(run.saved_step(), Some(stop));
    }
    let saved = SavedRun::open(RunFolder::new(&parts)).unwrap();
    assert_eq!(saved.completed_steps(), 23);
    let outcome = Run::resume(saved, dataset(), device()).unwrap().train(&mut ()).unwrap();
    for file in ["scene.safetensors", "checkpoint.safetensors", "stage_2dgs.safetensors"] {
        assert!(std::fs::read(whole.join(file)).unwrap() == std::fs::read(parts.join(file)).unwrap(), "{file}");
    }
    assert!(SceneData::load(&parts.join("scene.safetensors")).unwrap() == outcome.scene);
}

#[test]
fn a_run_goes_on_for_longer_and_with_a_dataset_that_moved() {
    let at = tempfile::tempdir().unwrap();
    let folder = RunFolder::new(at.path());
    in_folder(&SHORT, at.path()).train(&mut ()).unwrap();
    let saved = || SavedRun::open(folder.clone()).unwrap();

    let mut moved = saved();
    moved.move_to("elsewhere".to_owned());
    let other = Dataset { extent: 2.0 * dataset().extent, ..Dataset::clone(&dataset()) };
    let refused = error(Run::resume(moved.clone(), other, device()));
    assert!(refused.to_string().contains("it is another dataset"), "{refused}");
    let mut other_views = moved.clone();
    other_views.lengthen(36).unwrap();
    let mut renamed = Dataset::clone(&dataset());
    renamed.train[0].name = "other".to_owned();
    let bytes = || [folder.origin(), folder.config(), folder.evaluation()].map(|file| std::fs::read(file).unwrap());
    let before = bytes();
    let refused = error(Run::resume(other_views, renamed, device()));
    assert!(refused.to_string().contains("not the same ones"), "{refused}");
    assert!(bytes() == before, "what is refused changes nothing");
    drop(Run::resume(moved, dataset(), device()).unwrap());
    assert_eq!(saved().origin().dataset, "elsewhere");

    assert!(error(saved().lengthen(29)).to_string().contains("30 of 30 steps are done"));
    let mut longer = saved();
    let begins = |saved: &SavedRun| saved.plan().iter().map(|stage| stage.begin).collect::<Vec<_>>();
    let (before, said) = (begins(&longer), longer.lengthen(36).unwrap());
    assert!(begins(&longer) == before && said.contains("after 75 % of it"), "{said}");
    let outcome = Run::resume(longer, dataset(), device()).unwrap().train(&mut ()).unwrap();
    let Evaluation { psnr, .. } = outcome.evaluation.unwrap();
    assert_eq!((saved().completed_steps(), saved().config().train.steps), (36, 36));
    let again: EvalReport = read_json(&folder.evaluation()).unwrap();
    assert!(again.evaluation.psnr == psnr, "the scores are those of the longer run");
}

#[test]
fn corrections_of_views_are_in_the_folder_and_scores_say_what_they_are_worth() {
    let at = tempfile::tempdir().unwrap();
    let folder = RunFolder::new(at.path().join("run"));
    assert_eq!(folder.read_poses().unwrap(), None);
    let mut corrected = in_folder(&[&SHORT[..], &["train.exposure=on", "train.poses=on"]].concat(), folder.path());
    corrected.train(&mut ()).unwrap();
    let found: BTreeMap<String, Correction> = read_json(&folder.exposure()).unwrap();
    assert_eq!(found.keys().collect::<Vec<_>>(), ["train_000", "train_001", "train_002"]);
    for channel in 0..3 {
        let gain: f64 = found.values().map(|correction| correction.gain[channel].ln()).sum();
        let offset: f64 = found.values().map(|correction| correction.offset[channel]).sum();
        assert!(gain.abs() < 1e-5 && offset.abs() < 1e-5, "{found:?}");
    }
    let report: EvalReport = read_json(&folder.evaluation()).unwrap();
    let (all, view) = (&report.evaluation, &report.evaluation.views[0]);
    assert!(all.fitted.psnr_fitted.is_some() && view.scores.fitted.ssim_fitted.is_some());

    let found = folder.read_poses().unwrap().unwrap();
    assert_eq!(found.keys().collect::<Vec<_>>(), ["train_000", "train_001", "train_002"]);
    let mut views = dataset().train.clone();
    crate::views::pose::refine(&mut views, &found);
    for ((view, now), recorded) in views.iter().zip(&corrected.trainer().dataset().train).zip(&dataset().train) {
        let [found, now, recorded] = [view, now, recorded].map(|view| view.camera.camera_from_world);
        assert!((found.centre() - now.centre()).length() < 1e-12 && now != recorded);
    }
    std::fs::write(folder.poses(), "{").unwrap();
    let broken = folder.read_poses().unwrap_err().to_string();
    assert!(broken.contains("poses.json"), "{broken}");
    let mut lost = found.clone();
    lost.get_mut("train_001").unwrap().correction.rotation[2] = 1e300;
    std::fs::write(folder.poses(), serde_json::to_string(&lost).unwrap()).unwrap();
    let lost = folder.read_poses().unwrap_err().to_string();
    assert!(lost.contains("poses.json") && lost.contains("`train_001`") && lost.contains("1e300"), "{lost}");

    drop(corrected);
    let plain = run(&SHORT).overwrite(folder.clone(), Origin::new("builtin", "cpu"));
    plain.unwrap().train(&mut ()).unwrap();
    assert!(!folder.exposure().exists() && !folder.poses().exists());
    let text = std::fs::read_to_string(folder.evaluation()).unwrap();
    assert!(!text.contains("fitted"), "{text}");
}

/// Options of a run that validation views end.
const JUDGED: [&str; 4] = ["train.steps=400", "train.stop=validation", "train.evaluate_every=4", "train.patience=1"];

#[test]
fn validation_views_are_kept_and_end_a_run_with_the_best_scene() {
    let judged = |folder: Option<&Path>| {
        let mut run = on_nine(&JUDGED, folder);
        let mut notes = Notes::default();
        let scene = run.train(&mut notes).unwrap().scene;
        assert!(!run.trainer().dataset().validation.is_empty());
        let &(last, Verdict::Enough { best_step, best_psnr }) = notes.validated.last().unwrap() else {
            panic!("no verdict")
        };
        assert_eq!(last, best_step + 4);
        (scene, best_psnr)
    };
    let at = tempfile::tempdir().unwrap();
    let folder = at.path().join("run");
    let (scene, best_psnr) = judged(Some(&folder));
    assert!(judged(None).0 == scene && SceneData::load(&folder.join("scene.safetensors")).unwrap() == scene);
    let report: EvalReport = read_json(&folder.join("validation.json")).unwrap();
    assert_eq!((report.split.as_str(), report.evaluation.psnr), ("validation", best_psnr));
}

/// Options of a run that corrects its training views.
const CORRECTED: [&str; 3] = ["train.poses=on", "optimizer.pose_from=0", "train.exposure=on"];

#[test]
fn corrections_are_those_of_the_best_scene() {
    let set = [&JUDGED[..], &CORRECTED].concat();
    let at = tempfile::tempdir().unwrap();
    let folder = |name: &str| RunFolder::new(at.path().join(name));
    let begun = |name: &str| on_nine(&set, Some(folder(name).path()));
    let mut notes = Notes::default();
    let mut whole = begun("whole");
    whole.train(&mut notes).unwrap();
    let &(_, Verdict::Enough { best_step, .. }) = notes.validated.last().unwrap() else { panic!("no verdict") };
    error(begun("best").train(&mut Notes { stop: Some(best_step), ..Notes::default() }));
    let files = |name: &str| {
        let folder = folder(name);
        [folder.scene(), folder.exposure(), folder.poses()].map(|path| std::fs::read(path).unwrap())
    };
    assert!(files("whole") == files("best"), "after {best_step} steps");
    let last = whole.trainer().view_corrections();
    let exposure: BTreeMap<String, Correction> = read_json(&folder("whole").exposure()).unwrap();
    assert!(last.exposure != Some(exposure) && last.poses != folder("whole").read_poses().unwrap());
}

#[test]
fn corrections_are_those_of_the_stage_that_is_kept() {
    let set = ["train.steps=60", "stages.gaussians=0.7", "data.validation_every=3", "refine.budget=500"];
    let set = [&set[..], &["optimizer.decay=1e4"], &CORRECTED].concat();
    let at = tempfile::tempdir().unwrap();
    let folder = RunFolder::new(at.path());
    let mut run = on_nine(&set, Some(folder.path()));
    let scene = run.train(&mut ()).unwrap().scene;
    assert_eq!(scene.info.rendering, Rendering::Ellipsoids);
    let stage = run.trainer().last_but_one().unwrap();
    let [exposure, poses] = folder.corrections_of(&folder.stage_scene(&stage));
    let read = |path: &Path| std::fs::read(path).unwrap();
    assert!(read(&folder.exposure()) == read(&exposure) && read(&folder.poses()) == read(&poses));
    assert!(folder.read_poses().unwrap() != run.trainer().view_corrections().poses);
}

#[test]
fn a_last_stage_that_makes_validation_views_worse_is_undone() {
    let result = |decay: &str, folder: Option<&Path>| {
        let set = ["train.steps=60", "stages.gaussians=0.7", "data.validation_every=3", "refine.budget=500", decay];
        on_nine(&set, folder).train(&mut ()).unwrap().scene
    };
    let at = tempfile::tempdir().unwrap();
    let folder = at.path().join("worse");
    let worse = result("optimizer.decay=1e4", Some(&folder));
    assert_eq!(worse.info.rendering, Rendering::Ellipsoids);
    assert!(SceneData::load(&folder.join("scene.safetensors")).unwrap() == worse);
    assert!(SceneData::load(&folder.join("stage_dbs.safetensors")).unwrap() == worse);
    assert!(result("optimizer.decay=1e4", None) == worse);
    assert_eq!(result("optimizer.decay=1", None).info.rendering, Rendering::Peeled);
}

#[test]
fn errors_say_which_part_failed() {
    let at = tempfile::tempdir().unwrap();
    let folder = || RunFolder::new(at.path().join("run"));
    let no_checkpoint = error(SavedRun::open(folder()));
    assert!(matches!(no_checkpoint, RunError::Folder(RunFolderError::NoCheckpoint { .. })), "{no_checkpoint}");
    // killed before there is a checkpoint
    folder().start(&Origin::new("builtin", "cpu"), &Config::with(&SHORT).unwrap()).unwrap();
    for begun in [error(SavedRun::open(folder())), RunError::Folder(folder().check_unused().unwrap_err())] {
        assert!(matches!(begun, RunError::Folder(RunFolderError::Begun { .. })), "{begun}");
    }
    std::fs::remove_dir_all(folder().path()).unwrap();
    in_folder(&SHORT, folder().path()).train(&mut ()).unwrap();
    let used = error(run(&SHORT).write_to(folder(), Origin::new("builtin", "cpu")));
    assert!(matches!(used, RunError::Folder(RunFolderError::Used { .. })), "{used}");
    let other = error(Run::resume(SavedRun::open(folder()).unwrap(), dataset_of(4), device()));
    assert!(matches!(other, RunError::Train(TrainError::Resume { .. })), "{other}");
    let whole = std::fs::read(folder().checkpoint()).unwrap();
    // as a file system leaves a file after a loss of power
    let zeros = [&whole[..whole.len() - 400], &[0; 400]].concat();
    for bytes in [&b"half"[..], &zeros] {
        std::fs::write(folder().checkpoint(), bytes).unwrap();
        let broken = error(SavedRun::open(folder()));
        assert!(matches!(broken, RunError::Checkpoint(CheckpointError::Content { .. })), "{broken}");
    }
    let two_views = error(Run::new(config(&["train.stop=validation"]), dataset_of(2), device()));
    assert!(matches!(two_views, RunError::Train(TrainError::Plan(_))), "{two_views}");
}

#[test]
fn a_step_that_is_not_finite_leaves_the_last_checkpoint_in_the_folder() {
    let at = tempfile::tempdir().unwrap();
    // the first step makes colours so large that their squares overflow in the next
    let set = ["train.steps=5", "train.checkpoint_every=1", "optimizer.base=1e30"];
    let mut run = in_folder(&set, &at.path().join("run"));
    let failed = error(run.train(&mut ()));
    assert!(matches!(failed, RunError::Train(TrainError::Loss { step: 2, .. })), "{failed}");
    assert_eq!(run.saved_step(), Some(1));
}

#[test]
fn a_device_that_has_failed_leaves_the_files_of_earlier_steps_alone() {
    let at = tempfile::tempdir().unwrap();
    let mut run = in_folder(&SHORT, &at.path().join("run"));
    let mut notes = Notes { fails_after: Some(15), ..Notes::default() };
    let failed = error(run.train(&mut notes));
    assert!(matches!(failed, RunError::Train(TrainError::Device { .. })), "{failed}");
    assert_eq!((run.saved_step(), notes.saved), (Some(12), vec![10, 12]));
}
