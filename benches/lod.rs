//! `cargo bench -p dpges-benches --bench lod`: time and memory of making levels of detail of a synthetic scene of 5 million
//! primitives; with `--scene RUN`, how much each level of a trained one shows of it.

use std::path::{Path, PathBuf};
use std::time::Instant;

use burn::tensor::Device;
use clap::Parser;
use dpges_benches::{machine, resident_mib};
use dpges_core::camera::Camera;
use dpges_core::scene::SceneData;
use dpges_core::scene::tensors::tensor_to_rows;
use dpges_core::testing::scenes::realistic;
use dpges_lab::lod::{CELL_PRIMITIVES, Options, describe, level, write};
use dpges_train::device::DeviceName;
use dpges_train::eval::rendered::TrainingRenderer;
use dpges_train::run::scene::{Reading, Scene, every_nth};

/// Cameras that levels are compared from, evenly chosen.
const CAMERAS: usize = 20;

type Outcome<T = ()> = Result<T, Box<dyn std::error::Error>>;

#[derive(Parser)]
struct Arguments {
    /// Of the synthetic scene, a tenth of them surfels
    #[arg(long, default_value_t = 5_000_000)]
    primitives: usize,
    /// Folder of a run, instead of the synthetic scene
    #[arg(long)]
    scene: Option<PathBuf>,
    /// Steps of the fit of a level of the trained scene
    #[arg(long, default_value_t = 0)]
    fit: usize,
    #[arg(long, default_value_t = CELL_PRIMITIVES)]
    cell_primitives: usize,
    /// `cpu`, `wgpu` …
    #[arg(long, default_value = "cpu")]
    device: DeviceName,
    /// That cargo gives to every benchmark
    #[arg(long, hide = true)]
    bench: bool,
}

fn main() -> Outcome {
    let arguments = Arguments::parse();
    println!("{}", machine());
    let folder = tempfile::tempdir()?;
    match &arguments.scene {
        Some(run) => trained(&arguments, run, folder.path()),
        None => synthetic(&arguments, folder.path()),
    }
}

fn synthetic(arguments: &Arguments, folder: &Path) -> Outcome {
    let surfels = arguments.primitives / 10;
    let (scene, camera) = realistic(surfels, arguments.primitives - surfels, 1600, 1060, 1).into_scene();
    println!("{} primitives: {:.0} MiB with the scene in memory", arguments.primitives, resident_mib("VmRSS"));
    let start = Instant::now();
    let options = Options { cell_primitives: arguments.cell_primitives, cameras: &[camera], fit: None };
    let index = write(scene, &options, &folder.join("lod"))?;
    let (seconds, peak) = (start.elapsed().as_secs_f64(), resident_mib("VmHWM"));
    println!("{seconds:.1} s, {peak:.0} MiB peak");
    describe::of(&index).rows().iter().for_each(|(name, value)| println!("{name:6}  {value}"));
    Ok(())
}

fn trained(arguments: &Arguments, run: &Path, folder: &Path) -> Outcome {
    let device = arguments.device.open()?;
    let mut scene = Scene::load(run)?;
    scene.use_pinholes();
    let (source, dataset) = scene.read(None, &Reading::default(), false)?;
    let cameras: Vec<Camera> = dataset.train.iter().map(|view| view.camera).collect();
    let views: Vec<Camera> = every_nth(&dataset.train, CAMERAS).map(|view| view.camera).collect();
    let scene = scene.data;
    println!("{source}: {} surfels, {} Gaussians", scene.surfels.len(), scene.gaussians.len());
    let out = folder.join("lod");
    let fit = Some((arguments.fit, &device));
    let start = Instant::now();
    let options = Options { cell_primitives: arguments.cell_primitives, cameras: &cameras, fit };
    let index = write(scene.clone(), &options, &out)?;
    println!("{:.1} s with {} steps per level", start.elapsed().as_secs_f64(), arguments.fit);
    describe::of(&index).rows().iter().for_each(|(name, value)| println!("{name:6}  {value}"));
    let halves = index.level_count();
    println!("PSNR from {} cameras, dB, at full size, and at 1/2, 1/4 …", views.len());
    let whole = pictures(&scene, &views, halves, &device)?;
    for number in 0..index.level_count() {
        let found = pictures(&level(&index, number)?, &views, halves, &device)?;
        let psnr = |size: usize| {
            let pairs = whole[size].iter().zip(&found[size]);
            pairs.map(|(a, b)| psnr(a, b)).sum::<f64>() / views.len() as f64
        };
        let line: Vec<String> = (0..halves as usize).map(|size| format!("{:6.2}", psnr(size))).collect();
        println!("level {number}: {}", line.join(" "));
    }
    Ok(())
}

/// For each of `sizes`, of which the next has half the sides, planes of the pictures of `scene`.
fn pictures(scene: &SceneData, views: &[Camera], sizes: u32, device: &Device) -> Outcome<Vec<Vec<Vec<f32>>>> {
    let renderer = TrainingRenderer::new(scene, device);
    let mut all = Vec::new();
    for size in 0..sizes {
        let small = |camera: &Camera| camera.resized(camera.width >> size, camera.height >> size);
        let picture = |camera: &Camera| Ok(tensor_to_rows(renderer.render(&small(camera))?.image()));
        all.push(views.iter().map(picture).collect::<Outcome<_>>()?);
    }
    Ok(all)
}

fn psnr(a: &[f32], b: &[f32]) -> f64 {
    let squared: f64 = a.iter().zip(b).map(|(a, b)| f64::from(a.clamp(0.0, 1.0) - b.clamp(0.0, 1.0)).powi(2)).sum();
    -10.0 * (squared / a.len() as f64).log10()
}
