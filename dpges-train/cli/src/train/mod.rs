//! `dpges train`: from photographs to a scene.

pub mod display;
#[cfg(feature = "viewer")]
mod live;
pub mod options;
pub mod session;

use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use clap::Args;
use dpges_train::config::differences;
use dpges_train::dataset::source::run_name;
use dpges_train::device::place::Place;
use dpges_train::device::ranks::Job;
use dpges_train::device::{DeviceName, DeviceRequest};
use dpges_train::run::folder::{Origin, RunFolder, RunFolderError};
use dpges_train::run::targets::{Decision, Target, conclude};
use dpges_train::run::{Run, RunError, SavedRun, interrupts};

use super::data::Source;
use super::{Failure, Result, device_choice, sfm, table};
use crate::logging::LogStyle;
use options::ConfigArgs;
use session::Session;

/// Train a scene from photographs with known cameras
///
/// Without DATASET a small built-in scene is trained, in about two minutes on two cores; unless --preset or --config
/// is given, its defaults are 2000 steps and an evaluation and a checkpoint every 500. Likewise, a dataset in the Blender
/// layout begins with a stage of Gaussians by default.
///
/// Options win over --set, --set over --config, --config over --preset, --preset over the defaults.
#[derive(Debug, Args)]
#[command(after_help = "Ctrl-C finishes the step, saves a checkpoint and says how to go on; a second one aborts.")]
pub struct TrainArgs {
    /// Folder of a COLMAP, Blender or nerfstudio dataset, or `builtin`; or a folder of photographs, or a video: they go
    /// through `dpges sfm` first
    dataset: Option<PathBuf>,
    /// Folder of the run [default: runs/NAME OF THE DATASET]
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// auto (a GPU that passes a check, or else the CPU), cpu, wgpu (the best GPU), or another one that
    /// `dpges devices` lists [default: auto; with --resume, the device of the run]
    #[arg(long, value_name = "NAME")]
    device: Option<DeviceRequest>,
    #[command(flatten)]
    options: ConfigArgs,
    /// Reach a length of the training (5min) or a speed of the real-time renderer ("30 fps") by setting train.steps or
    /// refine.budget, after measuring this device; the run says what was expected and what was reached
    #[arg(long, value_name = "N UNIT", conflicts_with = "resume")]
    target: Option<Target>,
    /// Go on from the checkpoint in the run's folder
    #[arg(long, conflicts_with = "overwrite")]
    resume: bool,
    /// Replace the run in the folder
    #[arg(long)]
    overwrite: bool,
    /// Show the scene in a window while it trains
    #[cfg(feature = "viewer")]
    #[arg(long)]
    view: bool,
}

pub fn run(args: TrainArgs, style: LogStyle) -> Result<()> {
    let folder = args.folder();
    let job = Job::join()?;
    let summary = match catch_unwind(AssertUnwindSafe(|| train(args, style, &job))) {
        Ok(result) => result.inspect_err(|failure| give_up(&job, &failure.text()))?,
        Err(panic) => {
            give_up(&job, "it has panicked, see above");
            resume_unwind(panic)
        }
    };
    if !job.ranks.is_first() {
        return Ok(());
    }
    let reached = conclude(&folder)?.map(|text| table(&[("target", text)]));
    style.print(&(summary + &reached.unwrap_or_default()))
}

fn train(args: TrainArgs, style: LogStyle, job: &Job) -> Result<String> {
    args.check_alone(job)?;
    if !job.ranks.is_alone() {
        tracing::info!("{} ranks train one scene; of stages that sort, all do the same", job.ranks.count());
    }
    #[cfg(feature = "viewer")]
    if args.view {
        return live::train_in_window(move || args.session(style, &Job::join()?));
    }
    let session = args.session(style, job)?;
    session.train(&*interrupts::watch()?, &mut ())
}

/// Ends the other ranks of a job that cannot go on without this one.
pub fn give_up(job: &Job, reason: &str) {
    if !job.ranks.is_alone() {
        // in one piece beside those of other ranks
        let line = format!("rank {} of {}: {reason}\n", job.ranks.rank(), job.ranks.count());
        eprint!("{line}");
        job.end_others(1);
    }
}

impl TrainArgs {
    fn session(self, style: LogStyle, job: &Job) -> Result<Session> {
        if self.resume { self.resume(style, job) } else { self.start(style, job) }
    }

    /// Refuses what several ranks cannot do together.
    fn check_alone(&self, job: &Job) -> Result<()> {
        let option = match self {
            #[cfg(feature = "viewer")]
            Self { view: true, .. } => "--view",
            Self { target: Some(_), .. } => "--target",
            _ => return Ok(()),
        };
        if job.ranks.is_alone() { Ok(()) } else { Err(Failure::Usage(format!("{option} is for one process alone"))) }
    }

    fn source(&self) -> Source {
        Source::named(self.dataset.as_deref())
    }

    fn folder(&self) -> RunFolder {
        let named = || Path::new("runs").join(run_name(self.dataset.as_deref()));
        RunFolder::new(self.out.clone().unwrap_or_else(named))
    }

    /// Refuses options that set what the target decides.
    fn check_target(&self) -> Result<()> {
        let Some(target) = &self.target else { return Ok(()) };
        let taken = match target.decides() {
            Decision::Budget if self.options.budget.is_some() => "--budget",
            Decision::Steps if self.options.names_length() => "--steps and --steps-scale",
            _ => return Ok(()),
        };
        Err(Failure::Usage(format!("--target {target} decides what {taken} would: leave one of them out")))
    }

    fn start(self, style: LogStyle, job: &Job) -> Result<Session> {
        let source = self.source();
        let mut config = self.options.resolve(&source, &[])?;
        self.check_target()?;
        let folder = self.folder();
        let ranks = Arc::clone(&job.ranks);
        if !self.overwrite && ranks.is_first() {
            folder.check_unused().map_err(RunError::Folder)?;
        }
        let folder = if ranks.is_first() { folder.held()? } else { folder };
        let device = device_choice::select(self.device.unwrap_or_default())?;
        let device = device_choice::of_rank(job, device, self.device)?;
        if ranks.is_first() {
            sfm::prepare(self.dataset.as_deref(), &self.options.sfm(&config), style)?;
        }
        // the others wait for the cameras
        ranks.gather(&[]);
        let opened = device.open()?;
        let dataset = Arc::new(config.load_for_training(&source)?);
        let of = |target: &Target| target.plan(&mut config, &dataset, &opened);
        let plan = self.target.as_ref().map(of).transpose()?;
        let place = Place { device: opened, ranks };
        let run = Run::new(config, dataset, place)?.overwrite(folder.clone(), Origin::new(&source, device))?;
        if let Some(plan) = plan {
            plan.save(&folder)?;
        }
        Ok(Session { run, folder, device, style })
    }

    fn resume(self, style: LogStyle, job: &Job) -> Result<Session> {
        let mut folder = self.folder();
        if folder.has_checkpoint() && job.ranks.is_first() {
            folder = folder.held()?;
        }
        let mut saved = SavedRun::open(folder.clone()).map_err(|error| match error {
            RunError::Folder(RunFolderError::NoCheckpoint { .. }) => {
                Failure::with_help(error, "name the folder of a run with --out, or start one without --resume")
            }
            RunError::Folder(_) => Failure::with_help(error, "the folder is not complete: train anew into another one"),
            other => other.into(),
        })?;
        if self.dataset.is_some() && self.source().to_string() != saved.origin().dataset {
            tracing::info!("the dataset is {} from now on, before it was {}", self.source(), saved.origin().dataset);
            saved.move_to(self.source().to_string());
        }
        let source = Source::new(Path::new(&saved.origin().dataset));
        if let Source::Folder(path) = &source
            && !path.exists()
        {
            let message = format!("the dataset of the run is no longer at {}", path.display());
            return Err(Failure::with_help(
                message,
                "name where it is now: `dpges train DATASET --out FOLDER --resume`",
            ));
        }
        folder.write_config(saved.config())?;
        let mut asked = if self.options.names_a_whole() {
            self.options.resolve(&source, &[])?
        } else {
            self.options.resolve_on(&folder.config())?
        };
        let before = saved.config().train.steps;
        let steps =
            if self.options.steps.is_some() { std::mem::replace(&mut asked.train.steps, before) } else { before };
        let differences = differences(saved.config(), &asked);
        if !differences.is_empty() {
            let list = differences.join(", ");
            return Err(Failure::Usage(format!("a run is resumed with the configuration it was started with: {list}")));
        }
        if steps != before {
            // not within the macro: that is not even evaluated under --quiet
            let said = saved.lengthen(steps)?;
            tracing::info!("{said}");
        }
        let device = device_choice::select_again(self.device, &saved.origin().device)?;
        let device = device_choice::of_rank(job, device, self.device)?;
        say_resumed(&saved, device);
        let opened = device.open()?;
        let dataset = saved.config().load_for_training(&source)?;
        let place = Place { device: opened, ranks: Arc::clone(&job.ranks) };
        Ok(Session { run: Run::resume(saved, dataset, place)?, folder, device, style })
    }
}

/// Says where `saved` goes on, and warns if it was started on another device.
pub fn say_resumed(saved: &SavedRun, device: DeviceName) {
    let before = &saved.origin().device;
    if device.to_string() != *before {
        tracing::warn!("resuming on {device} what was started on {before}: the result will differ a little");
    }
    tracing::info!("resuming after step {}", saved.completed_steps());
}
