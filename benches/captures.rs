//! `cargo bench -p dpges-benches --bench captures -- --views 1000 --megapixels 12`: the most memory that loading a large
//! capture and the first steps of a long training on it take, under several `data.memory`, and the time of both.
//!
//! Photographs are generated: eight different ones, which further views share, so that they take little room on disk. Each
//! budget runs in a process of its own, since a process' peak never falls.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Arc;
use std::time::Instant;

use clap::Parser;
use dpges_benches::{cpus, machine};
use dpges_train::config::Config;
use dpges_train::dataset::load;
use dpges_train::device::memory::PeakMemory;
use dpges_train::run::Trainer;
use image::{Rgb, RgbImage};

/// Different photographs.
const DIFFERENT: usize = 8;
/// Steps of the run that is begun.
const RUN: usize = 30_000;
const MEGA: f64 = 1e6;

#[derive(Debug, Parser)]
struct Arguments {
    /// Photographs
    #[arg(long, default_value_t = 60)]
    views: usize,
    /// Size of each photograph, at 4:3
    #[arg(long, default_value_t = 4.0)]
    megapixels: f64,
    /// Longest side that is trained on, px; 0 sets no limit
    #[arg(long, default_value_t = 1600)]
    resolution: usize,
    /// Steps that are taken, of the 30,000 of a run, so that no pass over all views falls among a few
    #[arg(long, default_value_t = 20)]
    steps: usize,
    /// Values of `data.memory`
    #[arg(long, num_args = 1.., default_values = ["100GB", "200MB", "0MB"])]
    memory: Vec<String>,
    /// Measure with the dataset in this folder, in this process
    #[arg(long, hide = true)]
    measure: Option<PathBuf>,
    /// Given by `cargo bench`
    #[arg(long, hide = true)]
    bench: bool,
}

/// A nerfstudio dataset: cameras on a circle around textured photographs.
fn write_capture(folder: &Path, views: usize, megapixels: f64) {
    let width = (megapixels * MEGA * 4.0 / 3.0).sqrt().round().max(4.0) as u32;
    let height = (width * 3 / 4).max(1);
    let images = folder.join("images");
    std::fs::create_dir_all(&images).expect("a folder in the temporary one");
    let mut frames = String::new();
    for index in 0..views {
        let path = images.join(format!("{index:05}.jpg"));
        if index < DIFFERENT {
            let colour = |x: u32, y: u32| {
                let wave = |at: u32, length: u32| ((at / length.max(1) + index as u32) * 37 % 256) as u8;
                Rgb([wave(x, width / 64), wave(y, height / 48), wave(x + y, width / 200)])
            };
            RgbImage::from_fn(width, height, colour).save(&path).expect("room for a photograph");
        } else {
            let of = images.join(format!("{:05}.jpg", index % DIFFERENT));
            let linked = std::fs::hard_link(&of, &path);
            linked.or_else(|_| std::fs::copy(&of, &path).map(|_| ())).expect("room for a photograph");
        }
        let angle = index as f64 / views as f64 * std::f64::consts::TAU;
        let (sin, cos) = angle.sin_cos();
        // looks at the origin from a distance of 3, with z up, in OpenGL axes
        let separator = if index == 0 { "" } else { "," };
        write!(
            frames,
            r#"{separator}{{"file_path": "images/{index:05}.jpg", "transform_matrix":
            [[{}, 0, {cos}, {}], [{cos}, 0, {sin}, {}], [0, 1, 0, 0], [0, 0, 0, 1]]}}"#,
            -sin,
            3.0 * cos,
            3.0 * sin
        )
        .expect("writing to a string");
    }
    let json = format!(r#"{{"camera_angle_x": 0.9, "w": {width}, "h": {height}, "frames": [{frames}]}}"#);
    std::fs::write(folder.join("transforms.json"), json).expect("room for the cameras");
}

fn measure(arguments: &Arguments, folder: &Path) {
    let memory = &arguments.memory[0];
    let set = [
        format!("data.memory={memory}"),
        format!("data.max_resolution={}", arguments.resolution),
        format!("train.steps={RUN}"),
        "refine.budget=20000".to_owned(),
        "init.random_gaussians=10000".to_owned(),
    ];
    let config = Config::resolve(None, None, &set).expect("a configuration");
    let peak = PeakMemory::start();
    let mebibytes = || peak.bytes().map_or(f64::NAN, |bytes| bytes as f64 / f64::from(1 << 20));
    let start = Instant::now();
    let data = load(folder, &config.data.load_options()).expect("the generated capture");
    let (loading, after_loading) = (start.elapsed().as_secs_f64(), mebibytes());
    let photographs: usize = data.train.iter().chain(&data.test).map(|view| view.photograph.size_bytes()).sum();
    let kept = data.train.iter().chain(&data.test).filter(|view| view.photograph.is_kept()).count();
    let (_, device) = cpus().into_iter().next().expect("a CPU backend");
    let data = Arc::new(data);
    let start = Instant::now();
    let mut trainer = Trainer::new(config, Arc::clone(&data), device).expect("a run");
    let beginning = start.elapsed().as_secs_f64();
    let read = data.train.iter().chain(&data.test).filter(|view| view.photograph.was_read()).count();
    let start = Instant::now();
    let mut loss = f64::NAN;
    for _ in 0..arguments.steps {
        loss = trainer.step().expect("a step").map_or(loss, |report| report.loss);
    }
    println!(
        "data.memory={memory}: {kept} photographs have room in memory, of all {:.0} MB; loaded in {loading:.1} s, peak \
         {after_loading:.0} MiB; begun in {beginning:.1} s, {read} photographs read; {} steps in {:.1} s, peak {:.0} MiB \
         (loss {loss:.6})",
        photographs as f64 / MEGA,
        arguments.steps,
        start.elapsed().as_secs_f64(),
        mebibytes()
    );
}

fn main() {
    let arguments = Arguments::parse();
    if let Some(folder) = &arguments.measure {
        return measure(&arguments, folder);
    }
    println!("{}; {} views of {} megapixels", machine(), arguments.views, arguments.megapixels);
    let folder = tempfile::tempdir().expect("a temporary folder");
    write_capture(folder.path(), arguments.views, arguments.megapixels);
    let own_path = std::env::current_exe().expect("this program has a path");
    for memory in &arguments.memory {
        let status = Command::new(&own_path)
            .arg("--measure")
            .arg(folder.path())
            .args(["--memory", memory, "--resolution", &arguments.resolution.to_string()])
            .args(["--steps", &arguments.steps.to_string()])
            .status()
            .expect("this program can be run");
        assert!(status.success(), "{memory}: {status}");
    }
}
