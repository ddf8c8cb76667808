//! `dpges trade`: speed, size and time that are gained for the quality that is lost.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use clap::{Args, value_parser};
use dpges_core::camera::Camera;
use dpges_lab::study::cell::Plan;
use dpges_lab::study::trade::bench::Bench;
use dpges_lab::study::trade::knob::KNOBS;
use dpges_lab::study::trade::subject::study;
use dpges_lab::study::trade::sweep::Sweep;
use dpges_lab::study::trade::trained::{Deadline, RUNS, train_each};
use dpges_lab::study::trade::variants;
use dpges_render::{Headless, check_drawn_as_trained};
use dpges_train::config::Config;
use dpges_train::config::duration::duration;
use dpges_train::dataset::Dataset;
use dpges_train::device::DeviceName;
use dpges_train::metrics::lpips::choice::load;
use dpges_train::run::hold::Hold;
use dpges_train::run::interrupts;
use glam::DVec3;

use super::{Training, conclude};
use crate::data::{Scene, Source, Split, ViewArgs, every_nth};
use crate::device_choice::{DeviceArgs, select, watched};
use crate::logging::LogStyle;
use crate::lpips::LpipsArgs;
use crate::render::Engine;
use crate::train::options::of_dataset;
use crate::{Failure, Result};
use dpges_render::path::Size;

/// Most training views that say what a primitive contributes.
const JUDGING_VIEWS: usize = 32;

/// Measure what is lost in quality for what is gained in speed, size and time
///
/// Draws the scene at different settings of rendering (layers, footprint, steepness of rims, lobes, primitives,
/// resolution, 16-bit sums; each alone, then some together), and with --train trains it at different settings. Each point
/// has PSNR, SSIM, FLIP and, with a network, LPIPS of the views, frame times and the size of the scene file. Results are
/// trade.csv, trade.json, plots with the frontier, and report.html. The same command again measures only what is missing. Held-out views decide
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
    #[command(flatten)]
    device: DeviceArgs,
    #[command(flatten)]
    lpips: LpipsArgs,
    /// Renderer of pictures and frames [default: raster, or training where there is no graphics adapter]
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
    #[arg(long, value_name = "TIME", value_parser = duration)]
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
    let deadline = Deadline::after(args.time_limit);
    let _held = Hold::of_folder(&args.out)?;
    let mut scene = Scene::load(&args.scene)?;
    scene.use_pinholes();
    let device = select(args.device.request)?;
    watched(device, || args.measure(&mut scene, device, deadline, style))
}

impl TradeArgs {
    fn measure(&self, scene: &mut Scene, name: DeviceName, deadline: Deadline, style: LogStyle) -> Result<()> {
        let config_of_run = scene.run_config();
        let choice = self.views.choice();
        let (source, dataset, split) = choice.load_to_decide(scene)?;
        if split == Split::Train && self.train {
            tracing::warn!(
                "runs are compared on views that they are trained on, where more primitives and steps always look better: \
                 train the scene with data.validation_every=8, or measure held-out views with --split test"
            );
        }
        let source = Source::named(Some(Path::new(&source.to_string())));
        let resolve = |more: &[String]| -> Result<Config> {
            let set = [&choice.reading.assignments[..], &self.set, more].concat();
            let of_dataset = if config_of_run.is_some() { &[] } else { of_dataset(&source) };
            Config::resolve_for(of_dataset, None, config_of_run.as_deref(), &set).map_err(Failure::from)
        };
        let config = self.train.then(|| resolve(&[])).transpose()?;
        let opened = name.open()?;
        let networks = load(&self.lpips.chosen, &opened)?;
        let bench = Bench {
            views: every_nth(split.of(&dataset), self.count as usize).collect(),
            offset: DVec3::from_array(scene.data.info.offset),
            sized: &|camera| self.size.apply(camera),
            rounds: self.rounds as usize,
            device: &opened,
            networks: &networks,
            headless: self.headless(scene)?,
            folder: &self.out,
        };
        let device = match &bench.headless {
            Some(headless) => headless.adapter_name(),
            None => format!("{}, by the renderer that is trained with", name.describe()?),
        };
        let mut study = study(&bench, &scene.path, &source.to_string(), split, &device)?;

        let interrupted = interrupts::watch()?;
        let is_interrupted = || interrupted.load(Ordering::SeqCst);
        let is_wanted = |knob: &str| self.only.is_empty() || self.only.iter().any(|wanted| wanted == knob);
        let sweep = Sweep {
            bench: &bench,
            scene: &scene.data,
            cameras: &judging_cameras(&dataset),
            is_wanted: &is_wanted,
            goes_on: &|| !deadline.is_over() && !is_interrupted(),
        };
        sweep.measure(&mut study)?;
        if let Some(config) = config.filter(|_| !is_interrupted()) {
            let interrupted = Arc::clone(&interrupted);
            let mut training = Training::new(source.clone(), &config, name, opened.clone(), style, interrupted)?;
            let variants = variants(&config, &training.dataset, &is_wanted);
            let (folder, dataset) = (self.out.join(RUNS), source.to_string());
            let plan = Plan { variants: &variants, seeds: self.seeds, folder: &folder, dataset: &dataset };
            let cells = plan.cells(resolve)?;
            train_each(&cells, &bench, &mut study, deadline, |cell, until| training.train(cell, until))?;
        }
        if is_interrupted() {
            conclude(&mut study, LogStyle::Quiet)?;
            let message = format!("interrupted: what was measured is in {}", self.out.display());
            return Err(Failure::with_help(message, "the same command goes on"));
        }
        conclude(&mut study, style)
    }

    /// `None` for the renderer that is trained with.
    fn headless(&self, scene: &Scene) -> Result<Option<Headless>> {
        match self.renderer {
            Some(Engine::Training) => Ok(None),
            Some(Engine::Raster) => {
                scene.warn_of_order("the real-time renderer sorts");
                Ok(Some(Headless::new()?))
            }
            None => {
                let headless = check_drawn_as_trained(&scene.data.info).and_then(|()| Headless::new());
                let of_training = "frame times are those of the renderer that is trained with";
                Ok(headless.inspect_err(|error| tracing::warn!("{of_training}: {error}")).ok())
            }
        }
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
}
