//! `dpges bench render`: frames per second of a scene.

use std::path::PathBuf;

use clap::Args;
use dpges_core::camera::Camera;
use dpges_core::scene::Peeling;
use dpges_render::check_drawn_as_trained;
use dpges_render::frame_times::Rounds;
use dpges_render::path::Size;
use dpges_train::device::DeviceRequest;
use dpges_train::eval::frame_rates::{FrameRates, Row};
use dpges_train::eval::rendered::TrainingRenderer;

use super::super::data::{Scene, ViewArgs, every_nth};
use super::super::device_choice::watched;
use super::super::{Result, device_choice, hold_report, print_report};

/// Measure frames per second of a scene over the cameras of a dataset
#[derive(Debug, Args)]
pub struct BenchRenderArgs {
    /// Scene file or folder of a run
    scene: PathBuf,
    #[command(flatten)]
    views: ViewArgs,
    /// Size of the pictures; the vertical field of view stays
    #[arg(long, value_name = "WIDTHxHEIGHT", default_value = "1920x1080")]
    size: Size,
    /// Numbers of layers, one row each; scenes of blended Gaussians have one row
    #[arg(long, value_name = "K,…", value_delimiter = ',', default_value = "1,2,3,4,5")]
    layers: Vec<usize>,
    /// Kinds of peeling, one row each. Default: as the scene was trained
    #[arg(long, value_name = "KIND,…", value_delimiter = ',')]
    peeling: Vec<Peeling>,
    /// Counted rounds over the cameras
    #[arg(long, value_name = "N", default_value_t = 10, value_parser = clap::value_parser!(u32).range(1..=100_000))]
    rounds: u32,
    /// Rounds before those
    #[arg(long, value_name = "N", default_value_t = 2)]
    warm_up: u32,
    /// At most this many cameras, evenly chosen
    #[arg(long, value_name = "N", default_value_t = 16, value_parser = clap::value_parser!(u32).range(1..=100_000))]
    cameras: u32,
    /// Also measure the renderer that is trained with, on this device (cpu, wgpu, …); that alone of --method stopthepop, htgs,
    /// sss and sortfree
    #[arg(long, value_name = "NAME")]
    training: Option<DeviceRequest>,
    /// Write the result to this file; `-` is standard output
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
}

pub fn run(args: &BenchRenderArgs) -> Result<()> {
    let _held = hold_report(args.json.as_deref())?;
    let mut scene = Scene::load(&args.scene)?;
    scene.use_pinholes();
    let (_, views) = args.views.choice().load(&mut scene)?;
    let cameras: Vec<Camera> =
        every_nth(&views, args.cameras as usize).map(|view| args.size.apply(&view.camera)).collect();
    let rounds = Rounds { warm_up: args.warm_up as usize, counted: args.rounds as usize };
    let data = &scene.data;
    let mut report = FrameRates {
        scene: scene.path.display().to_string(),
        surfels: data.surfels.len(),
        gaussians: data.gaussians.len(),
        width: args.size.width,
        height: args.size.height,
        cameras: cameras.len(),
        // without its rows there are those of the other renderer, if it is asked for
        rows: match check_drawn_as_trained(&data.info) {
            Ok(()) => Row::of_raster(data, &cameras, rounds, &args.layers, &args.peeling)?,
            Err(refusal) if args.training.is_none() => return Err(refusal.into()),
            Err(_) => Vec::new(),
        },
    };
    if let Some(request) = args.training {
        let device = device_choice::select(request)?;
        watched(device, || {
            let renderer = TrainingRenderer::new(data, &device.open()?);
            report.rows.push(Row::of_training(data, &cameras, rounds, &renderer, device.to_string())?);
            Ok(())
        })?;
    }
    print_report(args.json.as_deref(), &report, &report.table())
}
