//! Plans of the built-in scene, and their steps.

use std::path::Path;

use dpges_core::scene::{ColourModel, GaussianData, SceneData, SceneInfo, SurfelData};
use dpges_train::config::{Budget, Config};
use dpges_train::dataset::block::Block;
use dpges_train::dataset::{BuiltinOptions, Dataset, builtin};
use dpges_train::run::folder::{Origin, write_json};
use dpges_train::run::jobs::State;

use super::BlocksError;
use super::cameras::MeasuredBy;
use super::plan::Plan;
use super::split::Limit;
use super::steps::{Capture, Step};
use crate::fixtures::device;

fn dataset() -> Dataset {
    let options =
        BuiltinOptions { width: 24, height: 24, train_views: 8, test_views: 3, points: 500, ..Default::default() };
    builtin(&options)
}

fn plan(set: &[&str], limit: Limit) -> Result<Plan, BlocksError> {
    Plan::new("builtin".into(), &dataset(), Config::with(set).unwrap(), limit)
}

/// Where the points of the built-in scene are: a surfel and a Gaussian at each.
fn scene() -> SceneData {
    let (model, dataset) = (ColourModel::SphericalBeta { lobes: 2 }, dataset());
    let positions = dataset.points.positions.concat();
    let count = dataset.points.positions.len();
    let mut surfels = SurfelData::neutral(model, count);
    surfels.positions.clone_from(&positions);
    surfels.log_scales.fill(-2.5);
    let mut gaussians = GaussianData::neutral(model, count);
    gaussians.positions = positions;
    SceneData { info: SceneInfo { colour_model: model, ..SceneInfo::default() }, surfels, gaussians, environment: None }
}

fn done(capture: &mut Capture, step: Step, scene: &SceneData) {
    let folder = capture.run_folder(step);
    capture.prepare(step).unwrap();
    folder.start(&Origin::new("builtin", "cpu"), &capture.config(step).unwrap()).unwrap();
    scene.save(&folder.scene()).unwrap();
    capture.finish(step, &dataset(), &device().into()).unwrap();
}

#[test]
fn every_camera_is_in_a_block_whose_points_or_surfaces_it_shows() {
    let (at, dataset) = (tempfile::tempdir().unwrap(), dataset());
    plan(&[], Limit::Blocks(3)).unwrap().save(at.path(), &dataset).unwrap();
    assert!(image::open(at.path().join("plan.png")).unwrap().width() > 100);
    let mut capture = Capture::open(at.path()).unwrap();
    let check = |plan: &Plan| {
        assert_eq!(plan.blocks.iter().map(|block| block.points).sum::<usize>(), 500);
        for view in dataset.train.iter().chain(&dataset.test) {
            assert!(plan.blocks.iter().any(|block| block.cameras.contains(&view.name)), "{}", view.name);
        }
        for block in &plan.blocks {
            assert!(block.cameras.iter().any(|name| dataset.train.iter().any(|view| view.name == *name)));
        }
    };
    check(&capture.plan);
    assert_eq!(capture.plan.cameras_by, MeasuredBy::Points);
    let before = capture.plan.clone();
    done(&mut capture, Step::Coarse, &scene());
    let capture = Capture::open(at.path()).unwrap();
    check(&capture.plan);
    assert_eq!(capture.plan.cameras_by, MeasuredBy::CoarseScene);
    let cameras = |plan: &Plan| plan.blocks.iter().map(|block| block.cameras.len()).sum::<usize>();
    assert!(cameras(&capture.plan) <= cameras(&before), "what hides others leaves a camera fewer blocks");
    assert!(before.is_in(at.path()).unwrap(), "a plan is the same whatever its cameras were found by");
}

#[test]
fn steps_follow_one_another_and_are_done_once() {
    let (at, dataset) = (tempfile::tempdir().unwrap(), dataset());
    plan(&["train.steps=300"], Limit::Blocks(2)).unwrap().save(at.path(), &dataset).unwrap();
    let mut capture = Capture::open(at.path()).unwrap();
    let budget = |capture: &Capture, step| capture.config(step).unwrap().refine.budget;
    assert_eq!(budget(&capture, Step::Coarse), budget(&capture, Step::Block(0)));
    capture.plan.coarse_budget = Some(Budget::Primitives(900));
    assert_eq!(budget(&capture, Step::Coarse), Budget::Primitives(900));
    assert_ne!(budget(&capture, Step::Block(0)), Budget::Primitives(900));
    let message = |capture: &Capture, step| capture.state(step).unwrap_err().to_string();
    assert!(message(&capture, Step::Block(0)).contains("dpges blocks coarse"));
    assert!(message(&capture, Step::Block(2)).contains("the plan has 2"));
    assert_eq!(capture.state(Step::Coarse).unwrap(), State::New);
    done(&mut capture, Step::Coarse, &scene());
    assert_eq!(capture.state(Step::Coarse).unwrap(), State::Finished);
    assert!(
        message(&capture, Step::Merge).contains("blocks train") && message(&capture, Step::Merge).contains("--block 0")
    );

    capture.prepare(Step::Block(1)).unwrap();
    let file = capture.run_folder(Step::Block(1)).path().join("block.json");
    let block = Block::read(&file).unwrap();
    let planned = &capture.plan.blocks[1];
    assert_eq!((block.bounds, &block.views), (planned.grown, &planned.cameras));
    let [inside, around] =
        [&file.with_file_name("inside.safetensors"), &block.surroundings].map(|path| SceneData::load(path).unwrap());
    assert_eq!(inside.surfels.len() + around.surfels.len(), 500);
    assert!(inside.surfels.len() >= planned.points && !around.surfels.is_empty());
    let of_block = capture.config(Step::Block(1)).unwrap();
    assert_eq!(of_block.block(), Some(&*file));
    assert_eq!(of_block.plan(usize::MAX).len(), 1, "the joint stage alone");

    // every block is as the coarse scene, and so is what is joined
    for block in [0, 1] {
        done(&mut capture, Step::Block(block), &scene());
    }
    capture.prepare(Step::Merge).unwrap();
    let joined = SceneData::load(&capture.run_folder(Step::Merge).path().join("joined.safetensors")).unwrap();
    assert_eq!((joined.surfels.len(), joined.gaussians.len()), (500, 500));
    let merge = capture.config(Step::Merge).unwrap();
    assert_eq!((merge.total_steps(), merge.refine.budget, merge.block()), (30, Budget::Primitives(1000), None));
    assert_eq!(capture.state(Step::Merge).unwrap(), State::New);
    let slurm = capture.write_slurm("wgpu:1".parse().unwrap()).unwrap();
    assert_eq!(slurm.lines().count(), 4);
    let read = |name: &str| std::fs::read_to_string(at.path().join(name)).unwrap();
    for part in ["#SBATCH --array=0-1\n", "#SBATCH --requeue\n", "--block=\"$SLURM_ARRAY_TASK_ID\" --device=wgpu:1\n"] {
        assert!(read("blocks.sbatch").contains(part), "{part}");
    }
    assert!(read("coarse.sbatch").contains("#SBATCH --gres=gpu:1\n"));
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        assert_eq!(std::fs::metadata(at.path().join("submit.sh")).unwrap().permissions().mode() & 0o111, 0o111);
    }
    assert!(read("submit.sh").contains("--dependency=\"afterok:$blocks\" \"$@\" merge.sbatch"));
    capture.write_slurm("cpu".parse().unwrap()).unwrap();
    assert!(!read("coarse.sbatch").contains("gres"), "a job on a CPU asks for no GPU");
}

#[test]
fn a_step_with_other_options_is_refused() {
    let (at, dataset) = (tempfile::tempdir().unwrap(), dataset());
    plan(&["train.steps=300"], Limit::Blocks(2)).unwrap().save(at.path(), &dataset).unwrap();
    let refused = |plan: &Plan| plan.is_in(at.path()).unwrap_err().to_string();
    assert!(plan(&["train.steps=300"], Limit::Blocks(2)).unwrap().is_in(at.path()).unwrap());
    assert!(refused(&plan(&["train.steps=30"], Limit::Blocks(2)).unwrap()).contains("`train.steps` is 300, not 30"));
    assert!(refused(&plan(&["train.steps=300"], Limit::Blocks(3)).unwrap()).contains("2 blocks"));
    let coarse_budget = Some(Budget::Primitives(900));
    let denser = Plan { coarse_budget, ..plan(&["train.steps=300"], Limit::Blocks(2)).unwrap() };
    assert!(refused(&denser).contains("the budget of its coarse scene is that of a block, not 900"));
    let other = Plan { dataset: "/data/other".into(), ..plan(&["train.steps=300"], Limit::Blocks(2)).unwrap() };
    assert!(refused(&other).contains("/data/other"));
    assert!(!other.is_in(Path::new("nowhere")).unwrap());
    let capture = Capture::open(at.path()).unwrap();
    let folder = capture.run_folder(Step::Coarse);
    folder.start(&Origin::new("builtin", "cpu"), &Config::with(&["train.steps=9"]).unwrap()).unwrap();
    write_json(&folder.checkpoint(), &"of a step").unwrap();
    let message = capture.state(Step::Coarse).unwrap_err().to_string();
    assert!(message.contains("`train.steps` is 9, not 300") && message.contains("coarse"), "{message}");
}

#[test]
fn captures_that_cannot_be_split_are_refused() {
    let message = |set: &[&str], limit| plan(set, limit).unwrap_err().to_string();
    assert!(message(&["train.poses=on"], Limit::Blocks(2)).contains("train.poses"));
    assert!(message(&["train.method=mcmc"], Limit::Blocks(2)).contains("train.method"));
    assert!(message(&[], Limit::Blocks(501)).contains("at most"));
    let mut without = dataset();
    without.points = Default::default();
    let error = Plan::new("garden".into(), &without, Config::default(), Limit::Blocks(2)).unwrap_err().to_string();
    assert!(error.contains("garden has no points"), "{error}");
    let nowhere = Capture::open(Path::new("nowhere")).unwrap_err().to_string();
    assert!(nowhere.contains("dpges blocks plan DATASET --out nowhere"), "{nowhere}");
}
