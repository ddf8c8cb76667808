//! Commands that train many runs and report them: `ablate`, `benchmark`, `compare`, `trade`.

pub mod ablate;
pub mod benchmark;
pub mod compare;
pub mod trade;

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use burn::tensor::Device;
use clap::builder::PossibleValue;
use clap::{Args, value_parser};
use dpges_lab::study::cell::{Cell, Plan};
use dpges_lab::study::evaluated::{self, Further};
use dpges_lab::study::store::Study;
use dpges_lab::study::variant::Variant;
use dpges_lab::study::{report, sheets};
use dpges_train::config::{Config, DataConfig};
use dpges_train::dataset::Dataset;
use dpges_train::device::DeviceName;
use dpges_train::metrics::lpips::choice::load;
use dpges_train::run::folder::Origin;
use dpges_train::run::hold::Hold;
use dpges_train::run::jobs::State;
use dpges_train::run::{Observer, Run, SavedRun, interrupts};

use super::data::Source;
use super::device_choice::{DeviceArgs, select, watched};
use super::logging::LogStyle;
use super::lpips::LpipsArgs;
use super::train::options::ConfigArgs;
use super::train::say_resumed;
use super::train::session::Session;
use super::{Failure, Result, sfm};

/// Options of studies whose variants are all trained.
#[derive(Debug, Args)]
pub struct StudyArgs {
    /// Folder of a COLMAP, Blender or nerfstudio dataset, or `builtin`; or photographs or a video, see `dpges sfm`
    dataset: Option<PathBuf>,
    /// Folder for the runs and the report
    #[arg(long, value_name = "DIR", required_unless_present = "list")]
    out: Option<PathBuf>,
    #[command(flatten)]
    device: DeviceArgs,
    /// Number of runs of each: with the seed of the configuration, and with those that follow it
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = value_parser!(u64).range(1..=1000))]
    seeds: u64,
    #[command(flatten)]
    lpips: LpipsArgs,
    /// Measure popping of every run: FLIP between frames of a short path that are 1 and 7 apart, where the motion of the
    /// camera does not explain it
    #[arg(long)]
    popping: bool,
    #[command(flatten)]
    options: ConfigArgs,
}

/// The data and the device of the runs of a study.
struct Training {
    source: Source,
    dataset: Arc<Dataset>,
    /// As the dataset was read.
    data: DataConfig,
    name: DeviceName,
    device: Device,
    style: LogStyle,
    /// True from the first Ctrl-C on.
    interrupted: Arc<AtomicBool>,
}

impl StudyArgs {
    fn source(&self) -> Source {
        Source::named(self.dataset.as_deref())
    }

    fn out(&self) -> &Path {
        self.out.as_deref().unwrap_or(Path::new("."))
    }

    /// The configuration for the first seed, with `more` (`key=value`) on top.
    fn config(&self, more: &[String]) -> Result<Config> {
        self.options.resolve(&self.source(), more)
    }

    /// The device and the data, read as `config` says.
    fn load(&self, config: &Config, style: LogStyle) -> Result<Training> {
        let name = select(self.device.request)?;
        sfm::prepare(self.dataset.as_deref(), &self.options.sfm(config), style)?;
        Training::new(self.source(), config, name, name.open()?, style, interrupts::watch()?)
    }

    /// Trains what is left of `variants`, measures all, and completes and reports `study`.
    fn conduct(&self, mut study: Study, variants: &[Variant], mut training: Training) -> Result<()> {
        let _held = Hold::of_folder(self.out())?;
        let dataset = training.source.to_string();
        let plan = Plan { variants, seeds: self.seeds, folder: self.out(), dataset: &dataset };
        let cells = plan.cells(|more| self.config(more))?;
        let networks = load(&self.lpips.chosen, &training.device)?;
        cells.iter().try_for_each(|cell| cell.check(&training.dataset, &training.device))?;
        cells.iter().try_for_each(|cell| training.train(cell, &mut ()))?;
        let Training { dataset, name, device, style, .. } = &training;
        watched(*name, || {
            let further = Further { dataset, device, networks: &networks, popping: self.popping };
            for cell in &cells {
                further.measure(cell)?;
                study.content.rows.push(evaluated::row(cell)?);
            }
            let first_seed: Vec<&Cell> = cells.iter().take(variants.len()).collect();
            study.content.figures = sheets::write(self.out(), &first_seed, &dataset.test, device)?;
            conclude(&mut study, *style)
        })
    }
}

/// Completes, writes and prints `study`.
fn conclude(study: &mut Study, style: LogStyle) -> Result<()> {
    study.finish()?;
    let files = report::write(study)?;
    style.print(&(report::printed(study) + &files))
}

/// `variants` by their labels.
fn choices(variants: &[Variant]) -> Vec<PossibleValue> {
    variants
        .iter()
        .map(|variant| PossibleValue::new(variant.label).help(variant.about.trim_end_matches('.').to_owned()))
        .collect()
}

impl Training {
    /// With the views that `config` holds out, of which there are some.
    fn new(
        source: Source,
        config: &Config,
        name: DeviceName,
        device: Device,
        style: LogStyle,
        interrupted: Arc<AtomicBool>,
    ) -> Result<Self> {
        let dataset = Arc::new(config.load_for_training(&source)?);
        if dataset.test.is_empty() {
            let message = format!("{source} has no held-out views to compare runs on");
            return Err(Failure::with_help(message, "hold out views with --test-every"));
        }
        Ok(Self { source, dataset, data: config.data.clone(), name, device, style, interrupted })
    }

    /// Trains the steps of `cell` that are left. `observer` hears of everything and can stop the run.
    fn train(&mut self, cell: &Cell, observer: &mut dyn Observer) -> Result<()> {
        let Cell { config, folder, state, name, .. } = cell;
        if *state == State::Finished {
            tracing::info!("{name}: already finished");
            return Ok(());
        }
        if config.data != self.data {
            self.dataset = Arc::new(config.load_for_training(&self.source)?);
            self.data = config.data.clone();
        }
        let (dataset, opened) = (Arc::clone(&self.dataset), self.device.clone());
        let run = if *state == State::Begun {
            tracing::info!("{name}: resumed");
            let saved = SavedRun::open(folder.clone())?;
            say_resumed(&saved, self.name);
            Run::resume(saved, dataset, opened)?
        } else {
            tracing::info!("{name}: {} steps", config.train.steps);
            Run::new(config.clone(), dataset, opened)?
                .overwrite(folder.clone(), Origin::new(&self.source, self.name))?
        };
        let session = Session { run, folder: folder.clone(), device: self.name, style: self.style };
        session.train(&self.interrupted, observer)?;
        Ok(())
    }
}
