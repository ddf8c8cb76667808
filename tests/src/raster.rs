//! The real-time renderer against the one that is trained with: scenes that were trained, cameras that were held out.
//!
//! Without a graphics adapter the tests are ignored. With `DPGES_REQUIRE_GPU=1` they fail. On a software driver the longest
//! one is ignored, too, unless `DPGES_REQUIRE_GPU=1`, `--ignored` or `--include-ignored` asks for it.

use std::sync::{Arc, OnceLock};

use dpges_core::camera::Camera;
use dpges_core::scene::tensors::tensor_to_rows;
use dpges_core::scene::{EnvironmentData, Footprint, Peeling, Rendering, SceneData};
use dpges_render::{CameraPath, Headless, MAX_LAYERS, Precision, RasterRenderer, RenderError, RenderOptions, Up};
use dpges_train::config::Config;
use dpges_train::dataset::{BuiltinOptions, Dataset, builtin};
use dpges_train::eval::popping::Frame;
use dpges_train::eval::rendered::TrainingRenderer;
use libtest_mimic::{Failed, Trial};

use crate::devices::flex;
use crate::timing::trial;
use crate::{gpu, jumps, training};

type Test = fn(&Headless) -> Result<(), Failed>;

/// Least PSNR with 32-bit and with 16-bit sums, dB.
const LEAST_DB: [(Precision, f64); 2] = [(Precision::Float, 50.0), (Precision::Half, 40.0)];
/// Frames of the path along which popping is looked for.
const FRAMES: usize = 120;
/// Largest difference between two frames, in medians of all.
const LARGEST_SPIKE: f64 = 3.0;

pub fn trials() -> Vec<Trial> {
    let tests: [(&str, Test); 6] = [
        ("raster::a_trained_scene_looks_the_same", a_trained_scene_looks_the_same),
        (
            "raster::every_number_of_layers_and_peeling_looks_the_same",
            every_number_of_layers_and_peeling_looks_the_same,
        ),
        ("raster::scenes_of_stages_look_the_same", scenes_of_stages_look_the_same),
        ("raster::scenes_before_an_environment_look_the_same", scenes_before_an_environment_look_the_same),
        ("raster::nothing_pops_along_a_path", nothing_pops_along_a_path),
        ("raster::nothing_jumps_along_a_path", nothing_jumps_along_a_path),
    ];
    let headless = Headless::new();
    let required = gpu::is_required();
    let slow = (!required && gpu::is_software()).then_some("raster::nothing_pops_along_a_path");
    if let Ok(headless) = &headless {
        eprintln!("tests of the real-time renderer run on {}", headless.adapter_name());
    }
    let headless = headless.map_err(|error| error.to_string());
    let trial = |(name, test): (&'static str, Test)| {
        let trial = trial(name, "GPU", &headless, required, move |headless| test(&headless));
        if slow == Some(name) { trial.with_ignored_flag(true) } else { trial }
    };
    tests.map(trial).into()
}

fn dataset() -> Arc<Dataset> {
    static DATASET: OnceLock<Arc<Dataset>> = OnceLock::new();
    let options =
        BuiltinOptions { width: 64, height: 64, train_views: 12, test_views: 3, points: 800, ..Default::default() };
    Arc::clone(DATASET.get_or_init(|| Arc::new(builtin(&options))))
}

/// A scene after `steps` steps with the keys `set`.
fn trained(steps: usize, set: &[&str]) -> SceneData {
    let steps = format!("train.steps={steps}");
    let config = Config::with(&[&[&steps, "refine.budget=3000"], set].concat()).unwrap();
    training::trained(&dataset(), config, &flex()).scene()
}

fn joint() -> &'static SceneData {
    static SCENE: OnceLock<SceneData> = OnceLock::new();
    SCENE.get_or_init(|| trained(150, &[]))
}

/// Held-out cameras, larger and of another shape than what was trained on.
fn cameras(scene: &SceneData) -> Vec<Camera> {
    let wide = |camera: &Camera| Camera { width: 200, cx: camera.cx + 30.0, near: scene.info.near, ..*camera };
    dataset().test.iter().map(|view| wide(&view.camera.resized(140, 140))).collect()
}

/// dB
fn psnr(found: &[f32], expected: &[f32]) -> f64 {
    assert_eq!(found.len(), expected.len());
    let squares = found.iter().zip(expected).map(|(a, b)| f64::from(a - b).powi(2));
    -10.0 * (squares.sum::<f64>() / found.len() as f64).log10()
}

fn compare(headless: &Headless, name: &str, scene: &SceneData) -> Result<(), Failed> {
    let renderer = TrainingRenderer::new(scene, &flex());
    let options = RenderOptions::from(&scene.info);
    let best = RasterRenderer::best_precision(headless.device());
    let depths = RasterRenderer::best_depths(headless.device());
    let can = |&(precision, _): &(Precision, f64)| precision == Precision::Half || best == precision;
    let with = |(precision, least)| {
        let mut own = headless.float_renderer(precision, depths)?;
        own.upload(scene)?;
        Ok((precision, own, least))
    };
    let mut own = LEAST_DB.into_iter().filter(can).map(with).collect::<Result<Vec<_>, RenderError>>()?;
    for camera in cameras(scene) {
        let expected = tensor_to_rows(renderer.render(&camera)?.image());
        let spread = expected.iter().fold([f32::MAX, f32::MIN], |[low, high], &v| [low.min(v), high.max(v)]);
        assert!(spread[1] - spread[0] > 0.3, "{name}: the picture is empty");
        for (precision, own, least) in &mut own {
            let db = psnr(&headless.planes(own, &camera, &options)?, &expected);
            println!("{name}, {precision:?}: {db:.1} dB");
            if db < *least {
                return Err(format!("{name}, {precision:?}: {db:.2} dB, expected at least {least}").into());
            }
        }
    }
    Ok(())
}

fn a_trained_scene_looks_the_same(headless: &Headless) -> Result<(), Failed> {
    compare(headless, "joint, sb2", joint())?;
    compare(headless, "joint, sh3", &trained(60, &["model.colour=sh3"]))
}

fn every_number_of_layers_and_peeling_looks_the_same(headless: &Headless) -> Result<(), Failed> {
    for layer_count in 1..=MAX_LAYERS {
        for (footprint, peeling) in [
            (Footprint::Kernel, Peeling::Continuous),
            (Footprint::Opacity, Peeling::Continuous),
            (Footprint::Kernel, Peeling::Literal),
            (Footprint::Opacity, Peeling::Nearest),
        ] {
            let mut scene = joint().clone();
            // rims that let much through need more than one layer
            (scene.info.layer_count, scene.info.modulation, scene.info.peeling) = (layer_count, 2.0, peeling);
            scene.info.footprint = footprint;
            compare(headless, &format!("K = {layer_count}, {footprint:?}, {peeling}"), &scene)?;
        }
    }
    Ok(())
}

fn scenes_of_stages_look_the_same(headless: &Headless) -> Result<(), Failed> {
    let methods = [("mcmc", Rendering::Ellipsoids), ("3dgs", Rendering::Ellipsoids), ("2dgs", Rendering::Discs)];
    for (method, rendering) in methods {
        let scene = trained(60, &[&format!("train.method={method}")]);
        assert_eq!(scene.info.rendering, rendering);
        compare(headless, method, &scene)?;
    }
    Ok(())
}

/// With a third of the primitives, so that much of what lies behind them is seen.
fn scenes_before_an_environment_look_the_same(headless: &Headless) -> Result<(), Failed> {
    let third = |count: usize| (0..count).step_by(3).collect::<Vec<usize>>();
    let blended = ["mcmc", "2dgs"].map(|method| trained(30, &[&format!("train.method={method}")]));
    for mut scene in [joint().clone()].into_iter().chain(blended) {
        scene.surfels = scene.surfels.select(&third(scene.surfels.len()));
        scene.gaussians = scene.gaussians.select(&third(scene.gaussians.len()));
        scene.info.background = [0.2, 0.3, 0.1];
        let bare = scene.clone();
        for degree in 0..=3 {
            let mut environment = EnvironmentData::neutral(degree);
            let coefficients = environment.coefficients.iter_mut().enumerate();
            coefficients.for_each(|(at, k)| *k = 0.4 * ((at * at) as f32 + 1.0).sin());
            scene.environment = Some(environment);
            let name = format!("{}, environment of degree {degree}", scene.info.rendering);
            compare(headless, &name, &scene)?;
            let [camera, ..] = cameras(&scene)[..] else { unreachable!("there are held-out cameras") };
            let own = tensor_to_rows(TrainingRenderer::new(&scene, &flex()).render(&camera)?.image());
            let without = tensor_to_rows(TrainingRenderer::new(&bare, &flex()).render(&camera)?.image());
            assert!(psnr(&own, &without) < 30.0, "{name}: little of it is seen");
        }
    }
    Ok(())
}

/// Mean absolute difference between `frame` and `earlier` as its camera would show it, where both show the same surface.
fn difference(frame: &Frame, earlier: &Frame) -> f64 {
    let warped = frame.warped(earlier);
    let differences = frame.planes.iter().zip(&warped.planes).map(|(a, b)| f64::from((a - b).abs()));
    let count = warped.is_seen.iter().filter(|&&is_seen| is_seen).count();
    // what is not seen in both does not differ
    differences.sum::<f64>() / (3 * count.max(1)) as f64
}

/// Largest and median difference between neighbours.
fn spikes(frames: &[Frame]) -> [f64; 2] {
    let mut differences: Vec<f64> = frames.windows(2).map(|pair| difference(&pair[1], &pair[0])).collect();
    differences.sort_unstable_by(f64::total_cmp);
    [differences[differences.len() - 1], differences[differences.len() / 2]]
}

/// A smooth path, frames compared after reprojection by the depth of the surfels.
fn nothing_pops_along_a_path(headless: &Headless) -> Result<(), Failed> {
    let scene = joint();
    let keys: Vec<Camera> = dataset().train.iter().map(|view| view.camera.resized(96, 96)).collect();
    // a slow turn, as someone who looks around makes it
    let path: Vec<Camera> = CameraPath::orbit(&keys, Up::Z)?.frames(8 * FRAMES).into_iter().take(FRAMES).collect();
    let surfels = TrainingRenderer::new(scene, &flex());
    let best = RasterRenderer::best_precision(headless.device());
    let depths = RasterRenderer::best_depths(headless.device());
    let mut renderer = headless.float_renderer(best, depths)?;
    renderer.upload(scene)?;
    let frame = |camera: &Camera| {
        let layers = surfels.render(camera)?;
        let depth = tensor_to_rows(&layers.peeled().ok_or("a peeled scene")?.layers.depth);
        let planes = headless.planes(&mut renderer, camera, &RenderOptions::from(&scene.info))?;
        Ok(Frame { camera: *camera, planes, depth: depth[..camera.width * camera.height].to_vec() })
    };
    let mut own = path.iter().map(frame).collect::<Result<Vec<Frame>, Failed>>()?;
    let [largest, median] = spikes(&own);
    println!("largest and median difference: {largest:.5}, {median:.5} ({:.2} medians)", largest / median);
    if median <= 0.0 || largest > LARGEST_SPIKE * median {
        return Err(format!("a step of {largest:.5} is {:.2} medians", largest / median).into());
    }
    // a frame in which something pops is found
    own[FRAMES / 2].planes.iter_mut().for_each(|value| *value += (LARGEST_SPIKE * median) as f32 * 2.0);
    let [popped, median] = spikes(&own);
    if popped <= LARGEST_SPIKE * median {
        return Err(format!("a frame that pops is not found: {:.2} medians", popped / median).into());
    }
    Ok(())
}

fn nothing_jumps_along_a_path(headless: &Headless) -> Result<(), Failed> {
    let best = RasterRenderer::best_precision(headless.device());
    let depths = RasterRenderer::best_depths(headless.device());
    for (name, scene, path) in jumps::scenes() {
        jumps::check(name, &scene, |scene| {
            let mut own = headless.float_renderer(best, depths)?;
            own.upload(scene)?;
            let options = RenderOptions::from(&scene.info);
            jumps::jumps(&path, |camera| headless.planes(&mut own, camera, &options))
        })?;
    }
    Ok(())
}
