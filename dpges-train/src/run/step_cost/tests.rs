use dpges_core::camera::Camera;
use dpges_core::counters::transfers::transfers;
use dpges_core::scene::{Rendering, SceneData};
use dpges_core::testing::scenes::realistic;

use super::*;
use crate::run::fixtures::device;

fn scene() -> (SceneData, Camera) {
    realistic(80, 400, 48, 32, 1).into_scene()
}

fn cost(scene: &SceneData, camera: Camera, stage: StepStage) -> StepCost {
    let mut steps = Steps::new(scene, &[camera, camera], stage, &device()).unwrap();
    measure(&mut steps, Rounds { warm_up: 1, counted: 3 }).unwrap()
}

#[test]
fn a_joint_step_trains_all_primitives_and_is_timed() {
    let (scene, camera) = scene();
    let found = cost(&scene, camera, StepStage::of(scene.info.rendering));
    assert_eq!((found.stage.as_str(), found.surfels, found.gaussians), ("joint", 80, 400));
    assert_eq!((found.views, found.width, found.height), (2, 48, 32));
    assert!(found.time.steps == 3 && found.time.median_ms > 0.0 && found.time.p95_ms >= found.time.median_ms);
    assert!(found.gpu.is_none());
    for list in [found.lists.surfels, found.lists.gaussians] {
        let list = list.unwrap();
        assert!(list.work.tiles == 6 && list.work.entries > 6, "{list:?}");
        assert!(list.inside_share.is_some_and(|share| share > 0.0 && share < 1.0), "{list:?}");
    }
    assert_eq!(cost(&scene, camera, StepStage::Joint).lists, found.lists, "the lists are those of the scene as given");
}

#[test]
fn a_blended_step_trains_gaussians_alone() {
    let (mut scene, camera) = scene();
    let found = cost(&scene, camera, StepStage::Blended);
    assert_eq!((found.stage.as_str(), found.surfels, found.gaussians), ("mcmc", 0, 400));
    assert!(found.lists.surfels.is_none() && found.lists.gaussians.is_some());
    scene.info.rendering = Rendering::Discs;
    let found = cost(&scene, camera, StepStage::of(scene.info.rendering));
    assert_eq!((found.stage.as_str(), found.gaussians), ("2dgs", 400));
    assert_eq!(found.lists, Lists { surfels: None, gaussians: None });
}

#[test]
fn every_step_on_a_cpu_uploads_its_photograph() {
    let (scene, camera) = scene();
    let mut steps = Steps::new(&scene, &[camera], StepStage::Joint, &device()).unwrap();
    let mut of_a_step = || {
        let before = transfers();
        steps.step().unwrap();
        transfers().since(before)
    };
    let first = of_a_step();
    assert!(first.uploads > 0 && first.uploaded_bytes >= 3 * 48 * 32 * 4, "{first:?}");
    assert!(first.downloads > 0, "{first:?}");
    assert_eq!(of_a_step(), first);
}

#[test]
fn nothing_to_train_and_nowhere_to_look_from_are_refused() {
    let (scene, camera) = scene();
    let refused = |scene: &SceneData, cameras: &[Camera], stage| {
        Steps::new(scene, cameras, stage, &device()).err().expect("it is refused").to_string()
    };
    assert!(refused(&scene, &[], StepStage::Joint).contains("no camera"));
    let only_surfels = SceneData { gaussians: scene.gaussians.select(&[]), ..scene };
    assert!(refused(&only_surfels, &[camera], StepStage::Blended).contains("80 surfels, 0 Gaussians"));
    assert!("mixed".parse::<StepStage>().unwrap_err().contains("joint"));
}
