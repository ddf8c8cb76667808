//! Blocks with the scene around them.

use std::path::Path;

use dpges_core::scene::{EnvironmentData, SceneData};

use super::{after, finished, goes_on_alike, trainer};
use crate::config::Config;
use crate::dataset::block::{Block, Bounds};
use crate::run::Trainer;
use crate::run::checkpoint::Checkpoint;
use crate::run::fixtures::{config, dataset, device, step_until};
use crate::run::folder::write_json;

const NOWHERE: Bounds = Bounds { max: [Some(f32::MIN); 3], ..Bounds::ALL };

/// A scene after a few steps, whose primitives with odd numbers are the block and the others are around it.
fn halves() -> [SceneData; 2] {
    let scene = after(trainer(&["train.steps=9", "model.environment=sh1"]), 3).scene();
    [1, 0].map(|first| {
        let rows = |count: usize| (first..count).step_by(2).collect::<Vec<_>>();
        SceneData {
            surfels: scene.surfels.select(&rows(scene.surfels.len())),
            gaussians: scene.gaussians.select(&rows(scene.gaussians.len())),
            ..scene.clone()
        }
    })
}

/// A run that begins with `inside`, with everything that changes something. Around it is `around`, if there is any.
fn block(at: &Path, inside: &SceneData, around: Option<&SceneData>, bounds: Bounds, more: &[&str]) -> Config {
    let file = |name: &str| at.join(name).display().to_string();
    inside.save(&at.join("inside.safetensors")).unwrap();
    let set = ["surfels", "gaussians"].map(|of| format!("stages.{of}_from={}", file("inside.safetensors")));
    let mut set: Vec<&str> = set.iter().map(String::as_str).collect();
    set.extend(["train.steps=60", "model.environment=sh1", "refine.budget=700", "refine.surfel_pixels=1px/MP"]);
    set.extend(["model.sampling_limit=0.3"]);
    set.extend(more);
    let mut config = config(&set);
    if let Some(around) = around {
        around.save(&at.join("around.safetensors")).unwrap();
        let views = dataset().train.iter().chain(&dataset().test).map(|view| view.name.clone()).collect();
        let block = Block { bounds, views, surroundings: "around.safetensors".into() };
        write_json(&at.join("block.json"), &block).unwrap();
        config.train.block = file("block.json");
    }
    config
}

fn trained(config: Config) -> Checkpoint {
    finished(Trainer::new(config, dataset(), device()).unwrap())
}

#[test]
fn empty_surroundings_change_no_byte() {
    let (folder, [inside, _]) = (tempfile::tempdir().unwrap(), halves());
    let nothing = SceneData {
        surfels: inside.surfels.select(&[]),
        gaussians: inside.gaussians.select(&[]),
        environment: None,
        ..inside.clone()
    };
    let alone = trained(block(folder.path(), &inside, None, Bounds::ALL, &[]));
    let mut surrounded = trained(block(folder.path(), &inside, Some(&nothing), Bounds::ALL, &[]));
    surrounded.state.config.train.block.clear();
    assert!(alone == surrounded);
}

#[test]
fn surroundings_are_drawn_and_neither_learn_nor_count_nor_go_into_the_scene() {
    let (folder, [inside, around]) = (tempfile::tempdir().unwrap(), halves());
    for new_gaussians in ["refine.new_gaussians=copies", "refine.new_gaussians=black"] {
        let config = block(folder.path(), &inside, Some(&around), Bounds::ALL, &[new_gaussians]);
        let mut trainer = Trainer::new(config, dataset(), device()).unwrap();
        let first = trainer.step().unwrap().unwrap();
        assert_eq!((first.surfels, first.gaussians), (inside.surfels.len(), inside.gaussians.len()));
        step_until(&mut trainer, Trainer::is_finished);
        let scene = trainer.scene();
        let all = trainer.complete(&scene).into_owned();
        assert!(scene.gaussians.len() > inside.gaussians.len() && scene.surfels.len() <= inside.surfels.len());
        assert!(scene.surfels.len() + scene.gaussians.len() <= 700, "the budget is that of the block");
        let tail = |from: usize, to: usize| (from..to).collect::<Vec<_>>();
        assert_eq!(all.surfels.select(&tail(scene.surfels.len(), all.surfels.len())), around.surfels);
        assert_eq!(all.gaussians.select(&tail(scene.gaussians.len(), all.gaussians.len())), around.gaussians);
        assert_eq!(scene.environment, inside.environment, "what is behind everything is that of all blocks");
    }
    // they are seen: with others the block learns something else
    let mut darker = around.clone();
    darker.gaussians.colour.base.iter_mut().for_each(|value| *value -= 0.5);
    let learnt = |around: &SceneData| {
        let config = block(folder.path(), &inside, Some(around), Bounds::ALL, &["train.steps=2"]);
        trained(config).attributes["gaussians.colour.base"].raw.clone()
    };
    assert!(learnt(&around) == learnt(&around) && learnt(&around) != learnt(&darker));
    let mut no_environment = around.clone();
    no_environment.environment = None;
    let config = block(folder.path(), &inside, Some(&no_environment), Bounds::ALL, &[]);
    let learnt: Option<EnvironmentData> = finished_scene(config).environment;
    assert_ne!(learnt, inside.environment);
}

fn finished_scene(config: Config) -> SceneData {
    let mut trainer = Trainer::new(config, dataset(), device()).unwrap();
    step_until(&mut trainer, Trainer::is_finished);
    trainer.scene()
}

#[test]
fn gaussians_come_within_the_bounds_alone() {
    let (folder, [inside, around]) = (tempfile::tempdir().unwrap(), halves());
    for new_gaussians in ["refine.new_gaussians=copies", "refine.new_gaussians=black"] {
        let counts = [NOWHERE, Bounds::ALL].map(|bounds| {
            let more = [new_gaussians, "refine.split_factor=0.01"];
            finished_scene(block(folder.path(), &inside, Some(&around), bounds, &more)).gaussians.len()
        });
        assert!(counts[0] <= inside.gaussians.len() && counts[1] > inside.gaussians.len(), "{counts:?}");
    }
}

#[test]
fn a_block_resumes_to_the_same_bytes() {
    let (folder, [inside, around]) = (tempfile::tempdir().unwrap(), halves());
    let config = block(folder.path(), &inside, Some(&around), Bounds::ALL, &[]);
    goes_on_alike(|| Trainer::new(config.clone(), dataset(), device()).unwrap(), &dataset(), &[31]);
}

#[test]
fn files_that_do_not_fit_are_named() {
    let (folder, [inside, around]) = (tempfile::tempdir().unwrap(), halves());
    let error = |config: Config| match Trainer::new(config, dataset(), device()) {
        Err(error) => error.to_string(),
        Ok(_) => panic!("not refused"),
    };
    let mut other_model = around.clone();
    other_model.info.offset[1] += 1.0;
    let message = error(block(folder.path(), &inside, Some(&other_model), Bounds::ALL, &[]));
    assert!(message.contains("train.block") && message.contains("around.safetensors"), "{message}");
    assert!(message.contains("origin"), "{message}");
    let mut config = block(folder.path(), &inside, Some(&around), Bounds::ALL, &[]);
    (config.stages.gaussians_from, config.stages.gaussians) = (String::new(), 0.5);
    assert!(error(config).contains("stages.gaussians_from"));
    let mut config = block(folder.path(), &inside, Some(&around), Bounds::ALL, &[]);
    std::fs::write(folder.path().join("block.json"), "{}").unwrap();
    assert!(error(config.clone()).contains("block.json"));
    config.train.block = "absent.json".into();
    assert!(error(config).contains("absent.json"));
}
