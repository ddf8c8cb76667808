//! `dpges blocks`: large captures in blocks.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use clap::{Args, Subcommand};
use dpges_lab::blocks::plan::Plan;
use dpges_lab::blocks::split::{Limit, MOST_POINTS};
use dpges_lab::blocks::steps::{Capture, Step};
use dpges_train::config::Budget;
use dpges_train::device::DeviceRequest;
use dpges_train::device::place::Place;
use dpges_train::device::ranks::Job;
use dpges_train::run::child::end_with_the_other;
use dpges_train::run::folder::Origin;
use dpges_train::run::interrupts;
use dpges_train::run::jobs::State;
use dpges_train::run::{Run, SavedRun};

use super::data::Source;
use super::device_choice::{DeviceArgs, watched};
use super::logging::LogStyle;
use super::train::options::ConfigArgs;
use super::train::session::Session;
use super::train::{give_up, say_resumed};
use super::{Result, device_choice, print, sfm};

/// Train a large capture in blocks
///
/// plan, coarse, train and merge follow one another. The same command again does what is left: nothing if it is done, or what
/// follows the last checkpoint. Blocks can be trained at the same time, by several processes or machines that share DIR:
/// `slurm` writes jobs, tools/dpges_ray.py has Ray start them.
#[derive(Debug, Args)]
pub struct BlocksArgs {
    #[command(subcommand)]
    command: BlocksCommand,
}

#[derive(Debug, Subcommand)]
enum BlocksCommand {
    Plan(Box<PlanArgs>),
    /// Train the coarse scene of the whole capture, and find the cameras of each block by it
    Coarse(StepArgs),
    /// Train the blocks that are left, one after another, each with the frozen coarse scene around it
    Train {
        #[command(flatten)]
        step: StepArgs,
        /// Train this block alone
        #[arg(long, value_name = "K")]
        block: Option<usize>,
    },
    /// Join the cores of all blocks and refine them together; DIR/merged/scene.safetensors is the result
    Merge(StepArgs),
    /// Write the steps as jobs of Slurm into DIR, and submit.sh, which submits them
    Slurm(StepArgs),
}

/// Plan the blocks of a capture
///
/// Halves the block with the most points, across its longest side, until none has too many. Writes DIR/plan.json and a picture
/// of blocks and cameras from above, DIR/plan.png. The options are those of the coarse run and of the run of every block.
#[derive(Debug, Args)]
struct PlanArgs {
    /// Folder of a COLMAP or nerfstudio dataset with points, or `builtin`; or photographs or a video, see `dpges sfm`
    dataset: PathBuf,
    /// Folder for the plan and its runs
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Number of blocks
    #[arg(long, value_name = "N", value_parser = at_least_one, conflicts_with = "points")]
    blocks: Option<usize>,
    /// Most points of a block
    #[arg(long, value_name = "N", value_parser = at_least_one, default_value_t = MOST_POINTS)]
    points: usize,
    /// Budget of the coarse scene [default: that of a block]. Blocks begin with its surfels: a larger one gains quality
    #[arg(long, value_name = "N|MB|auto")]
    coarse_budget: Option<Budget>,
    #[command(flatten)]
    options: ConfigArgs,
}

#[derive(Debug, Args)]
struct StepArgs {
    /// Folder of the plan
    dir: PathBuf,
    #[command(flatten)]
    device: DeviceArgs,
}

fn at_least_one(text: &str) -> Result<usize, String> {
    text.parse().ok().filter(|&number| number > 0).ok_or_else(|| "expected a whole number from 1".to_owned())
}

pub fn run(args: BlocksArgs, style: LogStyle) -> Result<()> {
    match args.command {
        BlocksCommand::Plan(args) => plan(&args, style),
        BlocksCommand::Coarse(args) => work(&args, style, |_| vec![Step::Coarse]),
        BlocksCommand::Train { step, block: Some(block) } => work(&step, style, |_| vec![Step::Block(block)]),
        BlocksCommand::Train { step, block: None } => work(&step, style, |capture| capture.blocks().collect()),
        BlocksCommand::Merge(args) => work(&args, style, |_| vec![Step::Merge]),
        BlocksCommand::Slurm(args) => print(&Capture::open(&args.dir)?.write_slurm(args.device.request)?),
    }
}

fn plan(args: &PlanArgs, style: LogStyle) -> Result<()> {
    let source = Source::named(Some(&args.dataset));
    let config = args.options.resolve(&source, &[])?;
    sfm::prepare(Some(&args.dataset), &args.options.sfm(&config), style)?;
    let dataset = source.load(&config.data.load_options())?;
    let limit = args.blocks.map_or(Limit::Points(args.points), Limit::Blocks);
    let plan = Plan { coarse_budget: args.coarse_budget, ..Plan::new(source.to_string(), &dataset, config, limit)? };
    if plan.is_in(&args.out)? {
        tracing::info!("{} holds this plan already", args.out.display());
    } else {
        plan.save(&args.out, &dataset)?;
    }
    style.print(&Capture::open(&args.out)?.progress())
}

/// Does what is left of `steps`.
fn work(args: &StepArgs, style: LogStyle, steps: impl Fn(&Capture) -> Vec<Step>) -> Result<()> {
    end_with_the_other();
    let job = Job::join()?;
    let all = || -> Result<()> {
        let mut capture = Capture::open(&args.dir)?;
        let interrupted = interrupts::watch()?;
        for step in steps(&capture) {
            finish(&mut capture, step, &job, args.device.request, style, &interrupted)?;
        }
        Ok(())
    };
    all().inspect_err(|failure| give_up(&job, &failure.text()))?;
    if job.ranks.is_first() { style.print(&Capture::open(&args.dir)?.progress()) } else { Ok(()) }
}

/// Does what is left of `step`.
fn finish(
    capture: &mut Capture,
    step: Step,
    job: &Job,
    device: DeviceRequest,
    style: LogStyle,
    interrupted: &AtomicBool,
) -> Result<()> {
    let ranks = Arc::clone(&job.ranks);
    capture.state(step)?;
    let _held = ranks.is_first().then(|| capture.lock(step)).transpose()?;
    ranks.gather(&[]);
    // another process may have done it in the meantime
    *capture = Capture::open(capture.folder())?;
    let state = capture.state(step)?;
    if state == State::Finished {
        tracing::info!("{step}: done already");
        return Ok(());
    }
    if state == State::New && ranks.is_first() {
        capture.prepare(step)?;
    }
    ranks.gather(&[]);
    let (folder, source) = (capture.run_folder(step), Source::new(Path::new(&capture.plan.dataset)));
    let name = device_choice::of_rank(job, device_choice::select(device)?, Some(device))?;
    let place = Place { device: name.open()?, ranks };
    let config = capture.config(step)?;
    let dataset = config.load_for_training(&source)?;
    let run = if state == State::Begun {
        let saved = SavedRun::open(folder.clone())?;
        say_resumed(&saved, name);
        Run::resume(saved, dataset, place.clone())?
    } else {
        tracing::info!("{step}: {} steps", config.total_steps());
        Run::new(config, dataset, place.clone())?.overwrite(folder.clone(), Origin::new(&source, name))?
    };
    let dataset = Arc::clone(run.trainer().dataset());
    let session = Session { run, folder, device: name, style };
    let summary = session.train(interrupted, &mut ())?;
    if place.ranks.is_first() {
        style.print(&summary)?;
    }
    watched(name, || Ok(capture.finish(step, &dataset, &place)?))
}
