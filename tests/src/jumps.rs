//! Nothing jumps when the camera moves: however short its steps are, a pixel changes by what it sees.

use burn::tensor::Device;
use dpges_core::camera::Camera;
use dpges_core::scene::tensors::tensor_to_rows;
use dpges_core::scene::{Peeling, SceneData};
use dpges_core::testing::scenes::realistic;
use dpges_train::eval::rendered::TrainingRenderer;
use glam::DVec3;

use crate::training;

/// Steps of a path. It is so short that an edge moves by less than a thirtieth of a pixel in a step.
const STEPS: usize = 128;
/// A pixel jumps if a channel changes by more, from 0 to 1: twice what the steepest edge changes by in a step.
const JUMP: f32 = 0.1;
/// Most jumps of a pixel along a path: of rims that are too many for the layers, and of surfels that stand on edge.
const MOST: f64 = 0.001;

/// A room with a ball before a camera that goes sideways, and a trained scene seen from a part of a turn.
pub fn scenes() -> Vec<(&'static str, SceneData, Vec<Camera>)> {
    let (room, camera) = realistic(500, 3_000, 64, 48, 5).into_scene();
    let path = (0..=STEPS).map(|step| {
        let mut pose = camera.camera_from_world;
        pose.translation += DVec3::new(-0.15, 0.05, 0.1) * step as f64 / STEPS as f64;
        Camera { camera_from_world: pose, ..camera }
    });
    let trained = training::trained(&training::dataset(), training::config(120, &[]), &crate::devices::flex()).scene();
    let views: Vec<Camera> = training::dataset().train.iter().map(|view| view.camera.resized(64, 64)).collect();
    let turn = dpges_render::CameraPath::arc(&views, dpges_render::Up::Z, 0.025, STEPS)
        .expect("cameras that look at one place");
    vec![("room", room, path.collect()), ("trained", trained, turn)]
}

/// The scene in strict order, whose rims end with a step and Gaussians pass layers at once.
pub fn in_strict_order(scene: &SceneData) -> SceneData {
    let mut scene = scene.clone();
    (scene.info.peeling, scene.info.layer_count) = (Peeling::Nearest, 3);
    scene
}

/// How often a pixel jumps along a path of which `frame` renders pictures, [3, H, W], mean over the pixels.
pub fn jumps<E>(cameras: &[Camera], frame: impl FnMut(&Camera) -> Result<Vec<f32>, E>) -> Result<f64, E> {
    let frames = cameras.iter().map(frame).collect::<Result<Vec<_>, E>>()?;
    let plane = cameras[0].width * cameras[0].height;
    let change = |pair: &[Vec<f32>], pixel: usize| {
        let of_channel = |c: usize| (pair[0][c * plane + pixel] - pair[1][c * plane + pixel]).abs();
        of_channel(0).max(of_channel(1)).max(of_channel(2))
    };
    let of_pair = |pair: &[Vec<f32>]| (0..plane).filter(|&pixel| change(pair, pixel) > JUMP).count();
    Ok(frames.windows(2).map(of_pair).sum::<usize>() as f64 / plane as f64)
}

/// Fails if it jumps, and if the strict order does not.
pub fn check<E>(name: &str, scene: &SceneData, jumps: impl Fn(&SceneData) -> Result<f64, E>) -> Result<(), E> {
    let [own, strict] = [jumps(scene)?, jumps(&in_strict_order(scene))?];
    println!("{name}: a pixel jumps {own:.5} times, in strict order {strict:.5} times");
    assert!(own <= MOST, "{name}: a pixel jumps {own:.5} times");
    assert!(strict > 5.0 * MOST, "{name}: in strict order a pixel jumps {strict:.5} times");
    Ok(())
}

/// With the renderer that is trained with.
pub fn nothing_jumps_along_a_path(device: &Device) {
    for (name, scene, path) in scenes() {
        let of = |scene: &SceneData| {
            let renderer = TrainingRenderer::new(scene, device);
            jumps(&path, |camera| Ok(tensor_to_rows(renderer.render(camera)?.image())))
        };
        check::<dpges_core::Error>(name, &scene, of).unwrap();
    }
}
