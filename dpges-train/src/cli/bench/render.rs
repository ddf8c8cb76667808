//! `dpges bench render`: frames per second of a scene.

use std::path::PathBuf;

use clap::Args;
use clap::builder::BoolishValueParser;
use dpges_core::camera::Camera;
use dpges_core::scene::{Rendering, SceneData};
use dpges_render::frame_times::{FrameTimes, Rounds, frame_times};
use dpges_render::path::Size;
use dpges_render::{Display, Headless, RenderOptions, check_drawn_as_trained};
use dpges_train::device::DeviceRequest;
use dpges_train::eval::rendered::Renderer;
use dpges_train::run::folder::write_json;
use serde::Serialize;

use super::super::data::{Scene, ViewArgs, every_nth};
use super::super::device_failure::watched;
use super::super::{Result, device_choice, print};

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
    #[arg(long, value_name = "K,…", value_delimiter = ',', default_value = "1,2,3,4")]
    layers: Vec<usize>,
    /// With a backstop, without, or both (`on,off`), one row each. Default: as the scene was trained
    #[arg(long, value_name = "on|off,…", value_delimiter = ',', value_parser = BoolishValueParser::new())]
    backstop: Vec<bool>,
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
    /// Write the figures as JSON
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
}

#[derive(Serialize)]
struct Report {
    scene: String,
    surfels: usize,
    gaussians: usize,
    width: usize,
    height: usize,
    cameras: usize,
    rows: Vec<Row>,
}

#[derive(Serialize)]
struct Row {
    /// `raster` or `training`
    renderer: &'static str,
    /// Adapter, or device.
    on: String,
    layers: Option<usize>,
    backstop: Option<bool>,
    #[serde(flatten)]
    times: FrameTimes,
}

pub fn run(args: &BenchRenderArgs) -> Result<()> {
    let mut scene = Scene::load(&args.scene)?;
    scene.use_pinholes();
    let (_, views) = args.views.load(&mut scene)?;
    let cameras: Vec<Camera> =
        every_nth(&views, args.cameras as usize).map(|view| args.size.apply(&view.camera)).collect();
    let mut report = Report {
        scene: scene.path.display().to_string(),
        surfels: scene.data.surfels.len(),
        gaussians: scene.data.gaussians.len(),
        width: args.size.width,
        height: args.size.height,
        cameras: cameras.len(),
        // without its rows there are those of the other renderer, if it is asked for
        rows: match check_drawn_as_trained(&scene.data.info) {
            Ok(()) => args.raster(&scene.data, &cameras)?,
            Err(refusal) if args.training.is_none() => return Err(refusal.into()),
            Err(_) => Vec::new(),
        },
    };
    if let Some(request) = args.training {
        let device = device_choice::select(request)?;
        watched(device, || {
            let renderer = Renderer::new(&scene.data, &device.open()?);
            let times = renderer.frame_times(&cameras, args.counts())?;
            let (info, peeled) = (&scene.data.info, is_peeled(&scene.data));
            let (layers, backstop) = (peeled.then_some(info.layer_count), peeled.then_some(info.backstop));
            report.rows.push(Row { renderer: "training", on: device.to_string(), layers, backstop, times });
            Ok(())
        })?;
    }
    if let Some(file) = &args.json {
        write_json(file, &report)?;
    }
    print(&report.table())
}

fn is_peeled(scene: &SceneData) -> bool {
    scene.info.rendering == Rendering::Peeled
}

impl BenchRenderArgs {
    fn raster(&self, scene: &SceneData, cameras: &[Camera]) -> Result<Vec<Row>> {
        let headless = Headless::new()?;
        let mut renderer = headless.renderer()?;
        renderer.upload(scene)?;
        let rounds = self.counts();
        let own = RenderOptions { display: Display::Image, ..RenderOptions::from(&scene.info) };
        let mut row = |layers: Option<usize>, backstop: Option<bool>| {
            let (layer_count, stops) = (layers.unwrap_or(own.layer_count), backstop.unwrap_or(own.backstop));
            let options = RenderOptions { layer_count, backstop: stops, ..own };
            let times = frame_times(&headless, &mut renderer, cameras, &options, rounds)?;
            Ok(Row { renderer: "raster", on: headless.adapter_name(), layers, backstop, times })
        };
        if !is_peeled(scene) {
            return Ok(vec![row(None, None)?]);
        }
        let trained = [own.backstop];
        let backstops = if self.backstop.is_empty() { &trained[..] } else { &self.backstop };
        let settings = self.layers.iter().flat_map(|&layers| backstops.iter().map(move |&backstop| (layers, backstop)));
        settings.map(|(layers, backstop)| row(Some(layers), Some(backstop))).collect()
    }

    fn counts(&self) -> Rounds {
        Rounds { warm_up: self.warm_up as usize, counted: self.rounds as usize }
    }
}

impl Report {
    fn table(&self) -> String {
        let Self { surfels, gaussians, width, height, cameras, .. } = self;
        let mut text = format!("{surfels} surfels, {gaussians} Gaussians, {width}x{height} px, {cameras} cameras\n");
        text += "renderer  K  backstop  frames/s    p50 ms    p99 ms  passes by the GPU's clock\n";
        for row in &self.rows {
            let layers = row.layers.map_or("-".to_owned(), |layers| layers.to_string());
            let backstop = row.backstop.map_or("-", |backstop| if backstop { "on" } else { "off" });
            let share = |pass: &dpges_render::frame_times::PassShare| {
                format!("{} {:.2} ms ({:.0} %)", pass.name, pass.p50_ms, 100.0 * pass.share)
            };
            let passes = row.times.passes.iter().map(share).collect::<Vec<_>>().join(", ");
            let FrameTimes { frames_per_second, p50_ms, p99_ms, .. } = row.times;
            let times = format!("{frames_per_second:8.1}  {p50_ms:8.2}  {p99_ms:8.2}");
            let line = format!("{:8}  {layers}  {backstop:8}  {times}  {passes}", row.renderer);
            text += line.trim_end();
            text += "\n";
        }
        let mut places: Vec<String> = self.rows.iter().map(|row| format!("{}: {}\n", row.renderer, row.on)).collect();
        places.dedup();
        text + &places.concat()
    }
}
