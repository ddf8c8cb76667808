//! `dpges trade`: what is gained in speed, size and time for what is lost in quality.

mod combine;
mod knob;
mod limit;
mod measure;
mod output;
mod pareto;
mod plot;
mod point;
mod report;
mod store;
mod sweep;
mod training;

use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;
use std::time::Duration;

use clap::{Args, value_parser};
use dpges_core::camera::Camera;
use dpges_core::scene::SceneInfo;
use dpges_render::{Headless, check_drawn};
use dpges_train::config::Config;
use dpges_train::dataset::Dataset;
use dpges_train::device::{DeviceName, DeviceRequest};
use dpges_train::eval::pictures::{self, save_png};
use glam::DVec3;

use crate::cli::data::{Scene, Source, Split, ViewArgs, every_nth};
use crate::cli::device_failure::watched;
use crate::cli::eval::make_folder;
use crate::cli::logging::LogStyle;
use crate::cli::lpips::LpipsArgs;
use crate::cli::render::Size;
use crate::cli::train::display::watch_for_interrupts;
use crate::cli::{Failure, Result, device_choice, duration, print};
use knob::KNOBS;
use limit::Limit;
use measure::{Bench, Engine};
use store::{Store, checksum};
use sweep::{PICTURES, Sweep};
use training::{Training, base_config};

/// Most training views that say what a primitive contributes.
const JUDGING_VIEWS: usize = 32;

/// Measure what is lost in quality for what is gained in speed, size and time
///
/// Draws the scene at different settings of rendering (layers, footprint, steepness of rims, lobes, primitives,
/// resolution, 16-bit sums; each alone, then some together), and with --train trains it at different settings. Each point
/// has PSNR, SSIM, FLIP and, with a network, LPIPS of the views, frame times and the size of the scene file. Results are trade.csv, trade.json,
/// plots with the frontier, and report.html. The same command again measures only what is missing. Held-out views decide
/// nothing unless they are asked for.
#[derive(Debug, Args)]
#[command(mut_arg("split", |split| split.help("Which views [default: validation if the run kept some, else train]")))]
pub struct TradeArgs {
    /// Scene file or folder of a run
    scene: PathBuf,
    #[command(flatten)]
    views: ViewArgs,
    /// Folder for the results
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Where pictures are compared and scenes trained: auto (a GPU that passes a check, or else the CPU), cpu, cpu-flex,
    /// wgpu (the best GPU), or another one that `dpges devices` lists
    #[arg(long, value_name = "NAME", default_value_t)]
    device: DeviceRequest,
    #[command(flatten)]
    lpips: LpipsArgs,
    /// What draws pictures and frames [default: raster, or training where there is no graphics adapter]
    #[arg(long, value_enum)]
    renderer: Option<Engine>,
    /// Size of the frames whose time is measured; the vertical field of view stays
    #[arg(long, value_name = "WIDTHxHEIGHT", default_value = "1920x1080")]
    size: Size,
    /// At most this many views, evenly chosen
    #[arg(long = "views", value_name = "N", default_value_t = 8, value_parser = value_parser!(u32).range(1..=100_000))]
    count: u32,
    /// Counted rounds over the views, for frame times
    #[arg(long, value_name = "N", default_value_t = 5, value_parser = value_parser!(u32).range(1..=100_000))]
    rounds: u32,
    /// Measure nothing that begins later, and stop a training that goes on longer; the same command goes on
    #[arg(long, value_name = "TIME", value_parser = duration::duration)]
    time_limit: Option<Duration>,
    /// Turn only these knobs, separated by commas
    #[arg(long, value_name = "KNOB", value_delimiter = ',', value_parser = KNOBS)]
    only: Vec<String>,
    /// Also train: budgets, lobes, layers, resolutions, lengths, a colour model and a method, as far as they differ from
    /// the configuration of the scene's run
    #[arg(long)]
    train: bool,
    /// Number of runs of each: with the seed of the configuration, and with those that follow it
    #[arg(long, value_name = "N", default_value_t = 1, requires = "train", value_parser = value_parser!(u64).range(1..=1000))]
    seeds: u64,
    /// Set a key of the configuration that is trained with, such as train.steps=2000; may be repeated
    #[arg(long, value_name = "KEY=VALUE", requires = "train")]
    set: Vec<String>,
}

pub fn run(args: &TradeArgs, style: LogStyle) -> Result<()> {
    let limit = Limit::new(args.time_limit);
    let mut scene = Scene::load(&args.scene)?;
    scene.use_pinholes();
    scene.warn_of_order("the real-time renderer sorts");
    let device = device_choice::select(args.device)?;
    watched(device, || args.measure(&mut scene, device, &limit, style))
}

impl TradeArgs {
    fn measure(&self, scene: &mut Scene, name: DeviceName, limit: &Limit, style: LogStyle) -> Result<()> {
        let config_of_run = scene.run_config();
        let (source, dataset, split) = self.views.load_to_decide(scene)?;
        if split == Split::Train && self.train {
            tracing::warn!(
                "runs are compared on views that they are trained on, where more primitives and steps always look better: \
                 train the scene with data.validation_every=8, or measure held-out views with --split test"
            );
        }
        let source = Source::named(Some(Path::new(&source.to_string())));
        let resolve = |more: &[String]| -> Result<Config> {
            let set = [&self.views.assignments()[..], &self.set, more].concat();
            base_config(&source, config_of_run.as_deref(), &set)
        };
        let config = self.train.then(|| resolve(&[])).transpose()?;
        let opened = name.open()?;
        let networks = self.lpips.load(&opened)?;
        let bench = Bench {
            views: every_nth(split.of(&dataset), self.count as usize).collect(),
            offset: DVec3::from_array(scene.data.info.offset),
            size: self.size,
            rounds: self.rounds as usize,
            name,
            device: &opened,
            networks: &networks,
            headless: self.headless(&scene.data.info)?,
        };
        let subject = self.subject(scene, &source, split, &bench)?;
        tracing::info!("drawn on {}", subject.device);
        make_folder(&self.out.join(PICTURES))?;
        let store = Store::open(&self.out, subject)?;
        let photograph = format!("{PICTURES}/photograph.png");
        let first = bench.views[0].picture()?;
        save_png(&pictures::photograph(&first), &self.out.join(&photograph))?;

        let interrupted = watch_for_interrupts()?;
        let mut sweep = Sweep::new(bench, &self.out, store);
        let cameras = judging_cameras(&dataset);
        let is_wanted = |knob: &str| self.only.is_empty() || self.only.iter().any(|wanted| wanted == knob);
        let of_scene = sweep::Subject { scene: &scene.data, cameras: &cameras, is_wanted: &is_wanted };
        sweep.render(&of_scene, &|| !limit.is_over() && !interrupted.load(Ordering::SeqCst))?;
        if let Some(config) = config.filter(|_| !interrupted.load(Ordering::SeqCst)) {
            let training = Training {
                source: &source,
                config: &config,
                resolve: &resolve,
                is_wanted: &is_wanted,
                seeds: self.seeds,
                name,
                device: &opened,
                style,
                interrupted: interrupted.clone(),
            };
            training.run(&mut sweep, &self.out, limit)?;
        }
        let store = sweep.finish()?;
        let files = output::write(&self.out, &store.trade, &photograph)?;
        if interrupted.load(Ordering::SeqCst) {
            let message = format!("interrupted: what was measured is in {}", self.out.display());
            return Err(Failure::with_help(message, "the same command goes on"));
        }
        if style == LogStyle::Quiet { Ok(()) } else { print(&(output::table(&store.trade) + &files)) }
    }

    /// `None` for the renderer that is trained with.
    fn headless(&self, info: &SceneInfo) -> Result<Option<Headless>> {
        match self.renderer {
            Some(Engine::Training) => Ok(None),
            Some(Engine::Raster) => Ok(Some(Headless::new()?)),
            None => Ok(check_drawn(info).and_then(|()| Headless::new()).map_or_else(
                |error| {
                    tracing::warn!("frame times are those of the renderer that is trained with: {error}");
                    None
                },
                Some,
            )),
        }
    }

    fn subject(&self, scene: &Scene, source: &Source, split: Split, bench: &Bench) -> Result<store::Subject> {
        let path = std::path::absolute(&scene.path)?;
        let first = &bench.views[0].camera;
        Ok(store::Subject {
            scene: path.display().to_string(),
            scene_checksum: checksum(&std::fs::read(&path)?),
            dataset: source.to_string(),
            split: split.to_string(),
            views: bench.views.iter().map(|view| view.name.clone()).collect(),
            view_size: [first.width, first.height],
            frame_size: [self.size.width, self.size.height],
            rounds: self.rounds as usize,
            device: bench.device_text()?,
        })
    }
}

/// Where the training views are, or the held-out ones without them.
fn judging_cameras(dataset: &Dataset) -> Vec<Camera> {
    let views = if dataset.train.is_empty() { &dataset.test } else { &dataset.train };
    every_nth(views, JUDGING_VIEWS).map(|view| view.camera).collect()
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;

    #[derive(Debug, Parser)]
    struct Command {
        #[command(flatten)]
        trade: TradeArgs,
    }

    fn parsed(arguments: &[&str]) -> Result<TradeArgs, String> {
        let command = Command::try_parse_from([&["trade", "run", "--out=a"], arguments].concat());
        command.map(|command| command.trade).map_err(|error| error.to_string())
    }

    #[test]
    fn options_are_checked() {
        let args = parsed(&["--time-limit=30min", "--views=3", "--train", "--seeds=2"]).unwrap();
        assert_eq!((args.time_limit, args.count, args.seeds), (Some(Duration::from_secs(1800)), 3, 2));
        assert!(parsed(&["--time-limit=30"]).unwrap_err().contains("s, min or h"));
        assert!(parsed(&["--seeds=2"]).unwrap_err().contains("--train"));
        assert!(parsed(&["--set=train.steps=3"]).unwrap_err().contains("--train"));
        assert!(parsed(&["--only=layers,lobes"]).unwrap_err().contains("[possible values: layers, footprint"));
        assert!(parsed(&["--size=big"]).unwrap_err().contains("1920x1080"));
        assert!(parsed(&["--views=0"]).is_err() && parsed(&["--rounds=0"]).is_err());
    }

    #[test]
    fn views_are_spread_over_all() {
        let options = dpges_train::dataset::BuiltinOptions {
            width: 4,
            height: 4,
            train_views: 7,
            test_views: 1,
            points: 0,
            ..Default::default()
        };
        let dataset = dpges_train::dataset::builtin(&options);
        let names = |most: usize| every_nth(&dataset.train, most).map(|view| view.name.as_str()).collect::<Vec<_>>();
        assert_eq!(names(3), ["train_000", "train_003", "train_006"]);
        assert_eq!((names(100).len(), names(1).len()), (7, 1));
        assert_eq!(judging_cameras(&dataset).len(), 7);
    }
}
