//! `cargo bench --workspace --bench stream -- FOLDER CAMERAS`: the streaming of a scene in levels of detail. `--help` says more.
//!
//! Measures the time to the first picture; for every budget, as a share of all primitives, the largest number of primitives
//! that were resident, and the PSNR against the whole scene from the cameras (`cameras.json` of 3DGS) once the cut is
//! complete; and the FLIP from frame to frame of a flight along the cameras, with the whole scene and streamed. Loads of the flight
//! take 50 ms and 20 ns a byte (50 MB/s) of a clock of 30 frames a second. The whole scene is `--scene`, or else level 0.

use std::collections::VecDeque;
use std::f64::consts::TAU;
use std::path::PathBuf;
use std::time::Instant;

use clap::Parser;
use dpges_benches::sized;
use dpges_core::camera::Camera;
use dpges_core::scene::SceneData;
use dpges_core::testing::scenes::realistic;
use dpges_lab::lod::{self, CELL_PRIMITIVES, Options};
use dpges_render::stream::{Levels, Loader, Source, Stream, decode};
use dpges_render::{CameraPath, Headless, RasterRenderer, RenderOptions, Rgb8Image};
use dpges_train::eval::pictures::save_png;
use dpges_train::metrics::flip;
use glam::DVec3;

/// Along the flight that is made.
const CAMERAS: usize = 20;
const FRAMES_PER_SECOND: f64 = 30.0;
const LATENCY_S: f64 = 0.05;
const SECONDS_PER_BYTE: f64 = 20e-9;

#[derive(Parser)]
struct Arguments {
    /// Folder of the scene in levels of detail
    folder: PathBuf,
    /// `cameras.json` of 3DGS
    cameras: PathBuf,
    /// The whole scene; level 0 without
    #[arg(long)]
    scene: Option<PathBuf>,
    /// Makes a synthetic scene of so many primitives and a flight into it first
    #[arg(long)]
    make: Option<usize>,
    /// Shares of all primitives
    #[arg(long, value_delimiter = ',', default_values_t = [1.0, 0.5, 0.25, 0.125])]
    budgets: Vec<f64>,
    #[arg(long, default_value_t = 640)]
    width: usize,
    #[arg(long, default_value_t = 360)]
    height: usize,
    /// Of the flight
    #[arg(long, default_value_t = 60)]
    frames: usize,
    /// Folder for pictures
    #[arg(long)]
    pictures: Option<PathBuf>,
    /// Given by `cargo bench`
    #[arg(long, hide = true)]
    bench: bool,
}

/// What draws, and what it draws for.
struct Bench {
    headless: Headless,
    options: RenderOptions,
    cameras: Vec<Camera>,
}

impl Bench {
    fn picture(&self, renderer: &mut RasterRenderer, camera: &Camera) -> Rgb8Image {
        self.headless.draw(renderer, camera, &self.options).expect("a picture")
    }

    fn save(&self, folder: Option<&PathBuf>, name: &str, picture: &Rgb8Image) {
        if let Some(folder) = folder {
            std::fs::create_dir_all(folder).expect("a folder for pictures");
            save_png(picture, &folder.join(name)).expect("a PNG");
        }
    }
}

fn main() {
    let arguments = Arguments::parse();
    if let Some(primitives) = arguments.make {
        make(&arguments, primitives);
    }
    let headless = Headless::new().expect("a graphics adapter");
    println!("adapter                 {}", headless.adapter_name());

    let started = Instant::now();
    let levels = Levels::open(&arguments.folder, usize::MAX).expect("a scene in levels of detail");
    let read = started.elapsed();
    let (info, counts) = (levels.scene().coarse().info.clone(), levels.scene().counts());
    let index = levels.scene().index().clone();
    let largest = index.cells.iter().filter(|cell| !cell.children.is_empty()).map(|cell| cell.primitives()).max();
    let all = counts[0] + counts[1] + largest.unwrap_or(0);
    let path = CameraPath::load(&arguments.cameras, &info).expect("cameras");
    let cameras = path.keys().iter().map(|camera| sized(camera, arguments.width, arguments.height)).collect();
    let bench = Bench { headless, options: RenderOptions::from(&info), cameras };
    drop(levels);

    // again, with all that a window does before its first picture
    let started = Instant::now();
    let mut renderer = bench.headless.renderer().expect("a renderer");
    let made = started.elapsed();
    let levels = Levels::open(&arguments.folder, all.min(2_000_000)).expect("a scene");
    let mut loader = Loader::new(levels, &mut renderer, || {}).expect("room for the coarsest level");
    loader.update(&mut renderer, &bench.cameras[0]);
    let first = bench.picture(&mut renderer, &bench.cameras[0]);
    println!(
        "first picture           {:.3} s, of which the renderer {:.3} s",
        started.elapsed().as_secs_f64(),
        made.as_secs_f64()
    );
    println!("opened, files cold?     {:.3} s", read.as_secs_f64());
    bench.save(arguments.pictures.as_ref(), "first.png", &first);
    drop(loader);

    let source = Source::new(&arguments.folder).expect("a folder");
    let whole = match &arguments.scene {
        Some(file) => SceneData::load(file).expect("a scene file"),
        None => lod::level(&index, 0).expect("all cells"),
    };
    let mut reference = bench.headless.renderer().expect("a renderer");
    reference.upload(&whole).expect("a scene that fits");
    drop(whole);
    let references: Vec<Rgb8Image> = bench.cameras.iter().map(|camera| bench.picture(&mut reference, camera)).collect();
    println!("primitives              {} surfels, {} Gaussians, {} cells", counts[0], counts[1], index.cells.len());
    println!(
        "{:>12} {:>12} {:>12} {:>10} {:>10} {:>12}",
        "share", "budget", "resident", "mean dB", "least dB", "ms a camera"
    );
    for &share in &arguments.budgets {
        let budget = (share * all as f64) as usize;
        let levels = Levels::open(&arguments.folder, budget).expect("a scene");
        let mut loader = match Loader::new(levels, &mut renderer, || {}) {
            Ok(loader) => loader,
            Err(error) => {
                println!("{share:>12} {budget:>12} {error}");
                continue;
            }
        };
        let (mut most, mut decibels) = (0, Vec::new());
        let started = Instant::now();
        for (at, (camera, reference)) in bench.cameras.iter().zip(&references).enumerate() {
            most = most.max(loader.complete(&mut renderer, camera).expect("cells"));
            let picture = bench.picture(&mut renderer, camera);
            decibels.push(psnr(&picture, reference));
            let beside = Rgb8Image::beside(&[picture, reference.clone()]);
            bench.save(arguments.pictures.as_ref(), &format!("{at:02}_{share}.png"), &beside);
        }
        assert!(most <= budget, "{most} of {budget}");
        let ms = 1e3 * started.elapsed().as_secs_f64() / bench.cameras.len() as f64;
        let mean = decibels.iter().sum::<f64>() / decibels.len() as f64;
        let least = decibels.iter().copied().fold(f64::INFINITY, f64::min);
        println!("{share:>12} {budget:>12} {most:>12} {mean:>10.2} {least:>10.2} {ms:>12.0}");
    }

    let flight = CameraPath::new(bench.cameras.clone(), false).expect("cameras").frames(arguments.frames);
    let alone = changes(flight.iter().map(|camera| bench.picture(&mut reference, camera)));
    println!("flight, whole           FLIP {:.5} mean, {:.5} largest", alone[0], alone[1]);
    for &share in &arguments.budgets {
        let budget = (share * all as f64) as usize;
        let Ok(levels) = Levels::open(&arguments.folder, budget) else { continue };
        let Ok(stream) = Stream::new(levels.scene(), budget, &mut renderer) else { continue };
        let streamed =
            fly(&bench, stream, &source, &mut renderer, &flight, arguments.pictures.as_ref().filter(|_| share == 0.5));
        println!(
            "flight, {share:<5}           FLIP {:.5} mean, {:.5} largest: {:.3} and {:.3} times as much",
            streamed[0],
            streamed[1],
            streamed[0] / alone[0],
            streamed[1] / alone[1]
        );
    }
}

/// Writes the synthetic scene and the cameras.
fn make(arguments: &Arguments, primitives: usize) {
    let surfels = primitives / 10;
    let (scene, camera) = realistic(surfels, primitives - surfels, 1600, 1060, 1).into_scene();
    let options = Options { cell_primitives: CELL_PRIMITIVES, cameras: &[camera], fit: None };
    lod::write(scene, &options, &arguments.folder).expect("levels of detail");
    let axes = camera.camera_from_world.rotation.transpose();
    let key = |at: usize| {
        let share = at as f64 / (CAMERAS - 1) as f64;
        let shift = 2.2 * share * axes.z_axis + 0.3 * (TAU * share).sin() * axes.x_axis;
        Camera { camera_from_world: camera.camera_from_world.moved(DVec3::ZERO, shift), ..camera }
    };
    let path = CameraPath::new((0..CAMERAS).map(key).collect(), false).expect("cameras");
    std::fs::write(&arguments.cameras, path.to_json()).expect("a file for cameras");
}

/// Flies with a clock of its own. Starts with a complete cut, as the whole scene does.
fn fly(
    bench: &Bench,
    mut stream: Stream,
    source: &Source,
    renderer: &mut RasterRenderer,
    flight: &[Camera],
    pictures: Option<&PathBuf>,
) -> [f64; 2] {
    let mut loads: VecDeque<(f64, usize)> = VecDeque::new();
    let mut free_at = 0.0;
    let mut step = |stream: &mut Stream, renderer: &mut RasterRenderer, camera: &Camera, now: f64| {
        while loads.front().is_some_and(|&(end, _)| end <= now) {
            let (_, cell) = loads.pop_front().expect("it has a front");
            let bytes = source.read(stream.part(cell)).expect("a cell");
            stream.take(cell, decode(stream.index(), cell, &bytes));
        }
        for cell in stream.update(renderer, camera, now) {
            free_at = now.max(free_at) + SECONDS_PER_BYTE * stream.part(cell).bytes as f64;
            loads.push_back((free_at + LATENCY_S, cell));
        }
    };
    let mut now = 0.0;
    while !stream.status(now).complete {
        step(&mut stream, renderer, &flight[0], now);
        now += 1.0 / FRAMES_PER_SECOND;
    }
    let mut drawn = 0;
    changes(flight.iter().map(|camera| {
        now += 1.0 / FRAMES_PER_SECOND;
        step(&mut stream, renderer, camera, now);
        let picture = bench.picture(renderer, camera);
        bench.save(pictures, &format!("flight_{drawn:03}.png"), &picture);
        drawn += 1;
        picture
    }))
}

/// Mean and largest FLIP between frames that follow each other.
fn changes(mut frames: impl Iterator<Item = Rgb8Image>) -> [f64; 2] {
    let mut before = frames.next().expect("a frame");
    let found: Vec<f64> = frames
        .map(|frame| {
            let [a, b] = [&before, &frame].map(planes);
            let change = flip(&a, &b, frame.width, frame.height);
            before = frame;
            change
        })
        .collect();
    [found.iter().sum::<f64>() / found.len() as f64, found.iter().copied().fold(0.0, f64::max)]
}

fn planes(picture: &Rgb8Image) -> Vec<f32> {
    let channel = |at: usize| picture.bytes.iter().skip(at).step_by(3).map(|&byte| f32::from(byte) / 255.0);
    (0..3).flat_map(channel).collect()
}

fn psnr(a: &Rgb8Image, b: &Rgb8Image) -> f64 {
    let squares = a.bytes.iter().zip(&b.bytes).map(|(&a, &b)| (f64::from(a) - f64::from(b)).powi(2)).sum::<f64>();
    -10.0 * (squares / a.bytes.len() as f64 / 255f64.powi(2)).log10()
}
