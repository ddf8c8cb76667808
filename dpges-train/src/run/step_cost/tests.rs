use std::collections::BTreeSet;

use dpges_core::camera::Camera;
use dpges_core::counters::{DeviceMemory, KernelWork};
use dpges_core::scene::{Rendering, SceneData};
use dpges_core::testing::scenes::realistic;
use serde_json::Value;

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
    assert!(found.steps == 3 && found.median_ms > 0.0 && found.p95_ms >= found.median_ms);
    assert!(found.gpu.is_none());
}

#[test]
fn a_blended_step_trains_gaussians_alone() {
    let (mut scene, camera) = scene();
    let found = cost(&scene, camera, StepStage::Blended);
    assert_eq!((found.stage.as_str(), found.surfels, found.gaussians), ("mcmc", 0, 400));
    scene.info.rendering = Rendering::Discs;
    let found = cost(&scene, camera, StepStage::of(scene.info.rendering));
    assert_eq!((found.stage.as_str(), found.gaussians), ("2dgs", 400));
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

/// A joint step on a GPU.
fn on_a_gpu() -> StepCost {
    let (scene, camera) = scene();
    let [long, short] = [Some(1.5), Some(0.25)].map(|milliseconds| KernelWork { launches: 2, milliseconds });
    let kernels =
        [("dpges_core::peel", short), ("dpges_core::splat", long)].map(|(name, work)| (name.to_owned(), work));
    let memory = DeviceMemory { alive_bytes: 1, peak_bytes: 2_500_000, reserved_bytes: 3 };
    StepCost { gpu: Some(GpuWork { kernels: kernels.into(), memory }), ..cost(&scene, camera, StepStage::Joint) }
}

#[test]
fn the_table_shows_the_longest_kernel_first() {
    let text = format!("{:?}", on_a_gpu().rows());
    for part in ["joint, 80 surfels, 400 Gaussians, 2 x 48x32 px", "of 3", "peak 2.50 MB", "4 of 2 kernels"] {
        assert!(text.contains(part), "{text}");
    }
    let [splat, peel] = ["1.500 ms     2 x dpges_core::splat", "0.250 ms     2 x dpges_core::peel"];
    assert!(text.find(splat).unwrap() < text.find(peel).unwrap(), "{text}");
}

/// Keys of all objects, but those that are names of kernels.
fn keys(value: &Value, found: &mut BTreeSet<String>) {
    for (key, value) in value.as_object().into_iter().flatten() {
        if !key.contains("::") {
            found.insert(key.clone());
        }
        keys(value, found);
    }
}

#[test]
fn every_key_is_documented() {
    let mut found = BTreeSet::new();
    keys(&serde_json::to_value(on_a_gpu()).unwrap(), &mut found);
    assert!(found.len() > 20, "{found:?}");
    let document = include_str!("../../../docs/guide/measure.md");
    for key in found {
        assert!(document.contains(&format!("`{key}`")), "docs/guide/measure.md says nothing of `{key}`");
    }
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
