//! `dpges bench step`: what a training step costs.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use burn::tensor::Device;
use clap::Args;
use dpges_core::camera::Camera;
use dpges_core::scene::SceneData;
use dpges_core::testing::scenes::realistic;
use dpges_render::path::Size;
use dpges_train::config::Config;
use dpges_train::dataset::View;
use dpges_train::dataset::source::{BUILTIN, Source};
use dpges_train::run::Trainer;
use dpges_train::run::step_cost::{Rounds, StepCost, StepStage, Steps, measure};
use serde::Serialize;

use super::super::data::{Scene, ViewArgs, every_nth};
use super::super::device_choice::{DeviceArgs, select, watched};
use super::super::{Failure, Result, hold_report, print_report, table};

/// Name of the synthetic scene of the benchmarks.
const REALISTIC: &str = "realistic";
/// Its picture, unless --size says otherwise, px.
const REALISTIC_SIZE: Size = Size { width: 400, height: 400 };

/// Measure a training step: time, and on a GPU launches, transfers and memory
///
/// The scene learns its own pictures, a little darker, and is not refined. docs/guide/measure.md explains every figure.
#[derive(Debug, Args)]
pub struct BenchStepArgs {
    /// Scene file or folder of a run; `builtin` (the built-in scene as its training begins), or `realistic` (a room of as
    /// many primitives as wanted)
    scene: PathBuf,
    #[command(flatten)]
    views: ViewArgs,
    /// Size of the pictures; the vertical field of view stays
    #[arg(long, value_name = "WIDTHxHEIGHT")]
    size: Option<Size>,
    /// Surfels of `realistic`
    #[arg(long, value_name = "N", default_value_t = 10_000)]
    surfels: usize,
    /// Gaussians of `realistic`
    #[arg(long, value_name = "N", default_value_t = 100_000)]
    gaussians: usize,
    /// joint (surfels and Gaussians) or blended (the Gaussians alone) instead of what the scene was made for
    #[arg(long, value_name = "STAGE")]
    stage: Option<StepStage>,
    /// Steps that are timed
    #[arg(long, value_name = "N", default_value_t = 30, value_parser = clap::value_parser!(u32).range(1..=100_000))]
    rounds: u32,
    /// Steps before those
    #[arg(long, value_name = "N", default_value_t = 5)]
    warm_up: u32,
    /// At most this many cameras, evenly chosen
    #[arg(long, value_name = "N", default_value_t = 4, value_parser = clap::value_parser!(u32).range(1..=100_000))]
    cameras: u32,
    #[command(flatten)]
    device: DeviceArgs,
    /// Write the result to this file; `-` is standard output
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
}

/// The content of the file of `--json`.
#[derive(Serialize)]
struct Report {
    scene: String,
    /// As --device takes it.
    device: String,
    adapter: String,
    /// Whether the adapter emulates a GPU on the CPU: only its counts are those of a GPU.
    emulated: bool,
    #[serde(flatten)]
    cost: StepCost,
}

pub fn run(args: &BenchStepArgs) -> Result<()> {
    let _held = hold_report(args.json.as_deref())?;
    let device = select(args.device.request)?;
    watched(device, || {
        let opened = device.open()?;
        let (scene, cameras) = args.scene(&opened)?;
        let stage = args.stage.unwrap_or_else(|| StepStage::of(scene.info.rendering));
        let mut steps = Steps::new(&scene, &cameras, stage, &opened)?;
        let rounds = Rounds { warm_up: args.warm_up as usize, counted: args.rounds as usize };
        let cost = measure(&mut steps, rounds)?;
        let (scene, adapter) = (args.scene.display().to_string(), device.describe()?);
        let report = Report { scene, device: device.to_string(), adapter, emulated: device.is_software(), cost };
        let note = if report.emulated { ", which emulates a GPU: its times are not those of one" } else { "" };
        let rows = [vec![("device", format!("{}{note}", report.adapter))], report.cost.rows()].concat();
        print_report(args.json.as_deref(), &report, &table(&rows))
    })
}

impl BenchStepArgs {
    /// The scene that is trained, and the cameras that see it.
    fn scene(&self, device: &Device) -> Result<(SceneData, Vec<Camera>)> {
        if self.scene == Path::new(REALISTIC) {
            if self.surfels + self.gaussians == 0 {
                return Err(Failure::Usage("--surfels 0 --gaussians 0 leaves nothing to train".into()));
            }
            let Size { width, height } = self.size.unwrap_or(REALISTIC_SIZE);
            let (scene, camera) = realistic(self.surfels, self.gaussians, width, height, 1).into_scene();
            return Ok((scene, vec![camera]));
        }
        if self.scene == Path::new(BUILTIN) {
            let config = Config::default();
            let dataset = Arc::new(Source::Builtin.load(&config.data.load_options())?);
            let scene = Trainer::new(config, Arc::clone(&dataset), device.clone())?.scene();
            return Ok((scene, self.cameras(&dataset.train)));
        }
        let mut scene = Scene::load(&self.scene)?;
        let (_, views) = self.views.choice().load(&mut scene)?;
        Ok((scene.data, self.cameras(&views)))
    }

    fn cameras(&self, views: &[View]) -> Vec<Camera> {
        let sized = |camera: &Camera| self.size.map_or(*camera, |size| size.apply(camera));
        every_nth(views, self.cameras as usize).map(|view| sized(&view.camera)).collect()
    }
}
