//! `dpges ablate`: the method, and the method without one of its parts, on the same data for the same steps.

mod report;
mod variant;

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use burn::tensor::Device;
use clap::Args;
use dpges_train::config::Config;
use dpges_train::dataset::Dataset;
use dpges_train::device::{DeviceName, DeviceRequest};
use dpges_train::eval::EvalReport;
use dpges_train::run::folder::{Origin, RunFolder};
use dpges_train::run::metrics_log::MetricsLog;
use dpges_train::run::{Run, SavedRun};

use super::data::Source;
use super::train::display::watch_for_interrupts;
use super::train::options::ConfigArgs;
use super::train::session::Session;
use super::train::{differences, say_resumed};
use super::{Failure, Result, device_choice, print};
use crate::logging::LogStyle;
use report::Row;
use variant::Variant;

/// Train the method and its ablations one after another, and compare them
///
/// Each variant is a run in a folder of its own, with the same data, seed and steps. The same command again skips finished
/// variants and resumes one that was interrupted. The comparison is written to ablation.csv and ablation.svg.
///
/// Without DATASET the built-in scene is used, with the defaults of `dpges train`.
#[derive(Debug, Args)]
pub struct AblateArgs {
    /// Folder of a COLMAP, Blender or nerfstudio dataset, or `builtin`
    dataset: Option<PathBuf>,
    /// Folder for the runs and the comparison
    #[arg(long, value_name = "DIR", required_unless_present = "list")]
    out: Option<PathBuf>,
    /// auto (a GPU that passes a check, or else the CPU), cpu, cpu-flex, wgpu (the best GPU), or another one that
    /// `dpges devices` lists
    #[arg(long, value_name = "NAME", default_value_t)]
    device: DeviceRequest,
    /// Variants to train, separated by commas, instead of those of the paper's table
    #[arg(long, value_name = "VARIANT", value_enum, value_delimiter = ',')]
    only: Vec<Variant>,
    /// Print all variants as a table in Markdown, and train nothing
    #[arg(long)]
    list: bool,
    #[command(flatten)]
    options: ConfigArgs,
}

/// How far the run of a variant has come.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum State {
    New,
    Begun,
    Finished,
}

/// The run of one variant.
struct Entry {
    variant: Variant,
    config: Config,
    folder: RunFolder,
    state: State,
}

/// What all runs share.
struct Common {
    source: Source,
    dataset: Arc<Dataset>,
    name: DeviceName,
    device: Device,
    style: LogStyle,
    interrupted: Arc<AtomicBool>,
}

pub fn run(args: &AblateArgs, style: LogStyle) -> Result<()> {
    let (false, Some(out)) = (args.list, &args.out) else { return print(&Variant::list()) };
    let source = Source::named(args.dataset.as_deref());
    let runs = args.runs(&source, out)?;
    if runs.iter().any(|run| run.state != State::Finished) {
        let common = Common::load(source, &runs[0].config, args.device, style)?;
        for run in &runs {
            run.train(&common)?;
        }
    }
    let rows = runs.iter().map(Entry::row).collect::<Result<Vec<Row>>>()?;
    let files = report::write(out, &rows)?;
    if style == LogStyle::Quiet { Ok(()) } else { print(&(report::table(&rows) + &files)) }
}

impl AblateArgs {
    /// The runs of the chosen variants. Folders that hold anything else are refused here, before the first step.
    fn runs(&self, source: &Source, out: &Path) -> Result<Vec<Entry>> {
        let run = |variant: Variant| -> Result<Entry> {
            let config = self.options.resolve(source, &variant.settings())?;
            let folder = RunFolder::new(out.join(variant.name));
            let state = state(&folder, &config, source)?;
            Ok(Entry { variant, config, folder, state })
        };
        Variant::chosen(&self.only).into_iter().map(run).collect()
    }
}

/// How far the run of `config` in `folder` has come.
///
/// # Errors
/// If the folder holds another run.
fn state(folder: &RunFolder, config: &Config, source: &Source) -> Result<State> {
    if folder.check_unused().is_ok() {
        return Ok(State::New);
    }
    let other = |reason: String| {
        let message = format!("{} holds another run: {reason}", folder.path().display());
        Failure::with_help(message, "choose another --out, or remove that folder")
    };
    let trained_on = folder.read_origin().map_err(|error| other(error.to_string()))?.dataset;
    if trained_on != source.to_string() {
        return Err(other(format!("it was trained on {trained_on}, not on {source}")));
    }
    let found = Config::resolve(None, Some(&folder.config()), &[]).map_err(|error| other(error.to_string()))?;
    let differences = differences(&found, config);
    if !differences.is_empty() {
        return Err(other(differences.join(", ")));
    }
    Ok(match (folder.evaluation().is_file(), folder.checkpoint().is_file()) {
        (true, _) => State::Finished,
        (false, true) => State::Begun,
        (false, false) => State::New,
    })
}

impl Common {
    fn load(source: Source, config: &Config, device: DeviceRequest, style: LogStyle) -> Result<Self> {
        let name = device_choice::select(device)?;
        let device = name.open()?;
        let dataset = Arc::new(source.load_for_training(config)?);
        if dataset.test.is_empty() {
            let help = "hold out views with --test-every";
            return Err(Failure::with_help(format!("{source} has no held-out views to compare variants on"), help));
        }
        Ok(Self { source, dataset, name, device, style, interrupted: watch_for_interrupts()? })
    }
}

impl Entry {
    /// Trains the steps that are left.
    fn train(&self, common: &Common) -> Result<()> {
        let Self { variant, config, folder, state } = self;
        let (data, opened) = (Arc::clone(&common.dataset), common.device.clone());
        let run = match state {
            State::Finished => {
                tracing::info!("{variant}: already finished");
                return Ok(());
            }
            State::Begun => {
                tracing::info!("{variant}: resumed");
                let saved = SavedRun::open(folder.clone())?;
                say_resumed(&saved, common.name);
                Run::resume(saved, data, opened)?
            }
            State::New => {
                tracing::info!("{variant}: {} steps", config.train.steps);
                let origin = Origin::new(&common.source, common.name);
                Run::new(config.clone(), data, opened)?.overwrite(folder.clone(), origin)?
            }
        };
        Session { run, folder: folder.clone(), device: common.name, style: common.style }.train(&common.interrupted)?;
        Ok(())
    }

    /// Its result.
    fn row(&self) -> Result<Row> {
        let report = read_evaluation(&self.folder.evaluation())?;
        Ok(Row {
            variant: self.variant,
            psnr: report.evaluation.psnr,
            ssim: report.evaluation.ssim,
            surfels: report.evaluation.surfels,
            gaussians: report.evaluation.gaussians,
            bytes: report.bytes,
            seconds: MetricsLog::seconds_of_steps(&self.folder.metrics())?,
        })
    }
}

fn read_evaluation(path: &Path) -> Result<EvalReport> {
    let wrong = |error: String| {
        let help = "remove it to finish its run again";
        Failure::with_help(format!("{} cannot be read: {error}", path.display()), help)
    };
    let text = std::fs::read_to_string(path).map_err(|error| wrong(error.to_string()))?;
    serde_json::from_str(&text).map_err(|error| wrong(error.to_string()))
}

#[cfg(test)]
mod tests {
    use dpges_train::run::folder::write_json;

    use super::*;

    #[test]
    fn a_folder_is_new_begun_finished_or_refused() {
        let at = tempfile::tempdir().unwrap();
        let folder = RunFolder::new(at.path().join("full"));
        let config = Config::default();
        let state = |config: &Config| state(&folder, config, &Source::Builtin);
        let refused = |config: &Config| match state(config) {
            Err(Failure::Failed(report)) => report.to_string(),
            _ => panic!("not refused"),
        };
        assert_eq!(state(&config).unwrap(), State::New);
        folder.start(&Origin::new(&Source::Builtin, "cpu"), &config).unwrap();
        assert_eq!(state(&config).unwrap(), State::New, "stopped before its first checkpoint");
        std::fs::write(folder.checkpoint(), "of a step").unwrap();
        assert_eq!(state(&config).unwrap(), State::Begun);
        std::fs::write(folder.evaluation(), "{}").unwrap();
        assert_eq!(state(&config).unwrap(), State::Finished);
        let mut longer = config.clone();
        longer.train.steps = 7;
        assert!(refused(&longer).contains("`train.steps` is 5000, not 7"));
        let elsewhere = Origin::new("/data/garden", "cpu");
        write_json(&folder.origin(), &elsewhere).unwrap();
        assert!(refused(&config).contains("/data/garden"));
    }
}
