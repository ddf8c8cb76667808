//! The `dpges` binary. Exit codes: 0, 1 for failure, 2 for wrong usage.
//!
//! One module for each subcommand.
//!
//! | crate | for |
//! |---|---|
//! | dpges-train, dpges-lab, dpges-render, dpges-core | what the subcommands do |
//! | clap, miette, thiserror | arguments; errors with advice |
//! | indicatif, tracing, tracing-indicatif, tracing-subscriber | progress, messages |
//! | libmimalloc-sys | how long the allocator keeps freed pages |

mod bench;
mod blocks;
mod clean;
mod compress;
mod config;
pub mod data;
pub mod device_choice;
mod devices;
pub mod eval;
mod export;
mod info;
mod inspect;
mod levels;
pub mod logging;
pub mod lpips;
pub mod progress;
#[cfg(test)]
mod reference;
pub mod render;
mod scale;
mod selftest;
pub mod sfm;
mod study;
pub mod train;
#[cfg(feature = "viewer")]
mod view;

use std::io::Write;
use std::path::Path;
use std::process::ExitCode;

use clap::error::ErrorKind;
use clap::{CommandFactory, Parser, Subcommand};
use dpges_lab::blocks::BlocksError;
use dpges_train::config::ConfigError;
use dpges_train::dataset::source::SourceError;
use dpges_train::device::allocator::{Allocator, explain_failures};
use dpges_train::device::ranks::launched;
use dpges_train::eval::export::page::PageError;
use dpges_train::eval::video::VideoError;
use dpges_train::metrics::lpips::choice::ChoiceError;
use dpges_train::run::folder::{hold_file, write_json};
use dpges_train::run::hold::Hold;
use dpges_train::run::scale::ScaleError;
use dpges_train::run::scene::SceneError;
use dpges_train::run::shots::ShotsError;
use libmimalloc_sys::{mi_option_set_default, mi_option_t};
use miette::{Diagnostic, MietteHandlerOpts, Report};
use serde::Serialize;

use logging::LogStyle;
use study::{ablate, benchmark, compare, trade};

#[global_allocator]
static ALLOCATOR: Allocator = Allocator;

/// `mi_option_purge_delay` of mimalloc 2 and 3: after how many ms freed pages go back to the kernel, which fills them with
/// zeros before it hands them out again.
const PURGE_DELAY: mi_option_t = 15;
const NEVER: std::ffi::c_long = -1;

fn main() -> ExitCode {
    // SAFETY: there is no other thread yet. `MIMALLOC_PURGE_DELAY` prevails.
    unsafe { mi_option_set_default(PURGE_DELAY, NEVER) };
    explain_failures();
    run()
}

/// Train, measure and look at depth-peeled Gaussian-enhanced surfels.
#[derive(Debug, Parser)]
#[command(name = "dpges", version, arg_required_else_help = true, args_override_self = true)]
struct Cli {
    #[command(subcommand)]
    command: Command,
    /// Show warnings and errors only
    #[arg(long, global = true)]
    quiet: bool,
    /// Write messages and progress to standard error as lines of JSON
    #[arg(long, global = true)]
    json_log: bool,
}

#[derive(Debug, Subcommand)]
enum Command {
    Train(train::TrainArgs),
    Sfm(sfm::SfmArgs),
    Data(inspect::InspectArgs),
    Ablate(ablate::AblateArgs),
    Compare(compare::CompareArgs),
    Benchmark(benchmark::BenchmarkArgs),
    Trade(trade::TradeArgs),
    Blocks(blocks::BlocksArgs),
    Config(config::ConfigArgs),
    Eval(eval::EvalArgs),
    Render(render::RenderArgs),
    #[cfg(feature = "viewer")]
    View(view::WindowArgs),
    /// Measure speed on this machine
    #[command(subcommand)]
    Bench(bench::BenchCommand),
    Export(export::ExportArgs),
    Compress(compress::CompressArgs),
    Clean(clean::CleanArgs),
    Scale(scale::ScaleArgs),
    Info(info::InfoArgs),
    Devices(devices::DevicesArgs),
    Selftest(selftest::SelftestArgs),
}

/// Why a command did not do what it was asked.
#[derive(Debug)]
pub enum Failure {
    /// Asked for wrongly: exit code 2.
    Usage(String),
    /// Exit code 1.
    Failed(Report),
}

pub type Result<T, E = Failure> = std::result::Result<T, E>;

impl<E: std::error::Error + Send + Sync + 'static> From<E> for Failure {
    fn from(error: E) -> Self {
        let message = error.to_string();
        if is_usage(&error) { Self::Usage(message) } else { Self::Failed(Report::new(Problem { message, help: None })) }
    }
}

/// Whether a command was asked for wrongly, as the errors say themselves that may mean it.
fn is_usage(error: &(dyn std::error::Error + 'static)) -> bool {
    macro_rules! any {
        ($($kind:ty),*) => { $(error.downcast_ref().is_some_and(<$kind>::is_usage))||* };
    }
    any!(BlocksError, ChoiceError, ConfigError, PageError, ScaleError, SceneError, ShotsError, SourceError, VideoError)
}

impl Failure {
    /// A failure with advice.
    pub fn with_help(message: impl ToString, help: impl ToString) -> Self {
        Self::Failed(Report::new(Problem { message: message.to_string(), help: Some(help.to_string()) }))
    }

    /// In one line, with the advice.
    pub fn text(&self) -> String {
        match self {
            Self::Usage(message) => message.clone(),
            Self::Failed(report) => match report.help() {
                Some(help) => format!("{report}: {help}"),
                None => report.to_string(),
            },
        }
    }
}

#[derive(Debug, thiserror::Error, Diagnostic)]
#[error("{message}")]
struct Problem {
    message: String,
    #[help]
    help: Option<String>,
}

/// Runs what the process was started with.
fn run() -> ExitCode {
    let cli = match Cli::try_parse() {
        Ok(cli) => cli,
        Err(error) => error.exit(),
    };
    // of several processes the first speaks for all
    let follows = launched().is_some_and(|launched| launched.rank > 0);
    let style = LogStyle::choose(cli.quiet || follows, cli.json_log);
    logging::init(style, cli.json_log, follows);
    keep_lines_whole();
    let result = match cli.command {
        Command::Train(args) => train::run(args, style),
        Command::Sfm(args) => sfm::run(&args, style),
        Command::Data(args) => inspect::run(&args, style),
        Command::Ablate(args) => ablate::run(&args, style),
        Command::Compare(args) => compare::run(&args, style),
        Command::Benchmark(args) => benchmark::run(args, style),
        Command::Trade(args) => trade::run(&args, style),
        Command::Blocks(args) => blocks::run(args, style),
        Command::Config(args) => config::run(&args),
        Command::Eval(args) => eval::run(args),
        Command::Render(args) => render::run(&args),
        #[cfg(feature = "viewer")]
        Command::View(args) => view::run(args),
        Command::Bench(command) => bench::run(&command),
        Command::Export(args) => export::run(&args),
        Command::Compress(args) => compress::run(&args),
        Command::Clean(args) => clean::run(&args),
        Command::Scale(args) => scale::run(&args),
        Command::Info(args) => info::run(&args),
        Command::Devices(args) => devices::run(&args),
        Command::Selftest(args) => selftest::run(&args),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(Failure::Usage(message)) => Cli::command().error(ErrorKind::ValueValidation, message).exit(),
        Err(Failure::Failed(report)) => {
            eprintln!("{report:?}");
            ExitCode::FAILURE
        }
    }
}

/// Messages name files and commands: they are not broken into lines, so that they can be copied.
fn keep_lines_whole() {
    let handler = || MietteHandlerOpts::new().wrap_lines(false).break_words(false).build();
    // Only fails if another handler is set, and none is.
    let _ = miette::set_hook(Box::new(move |_| Box::new(handler())));
}

/// Prints to standard output; a reader that has gone away is no failure.
pub fn print(text: &str) -> Result<()> {
    match std::io::stdout().write_all(text.as_bytes()) {
        Err(error) if error.kind() != std::io::ErrorKind::BrokenPipe => Err(error.into()),
        _ => Ok(()),
    }
}

/// Prints JSON to standard output.
pub fn print_json(value: &impl Serialize) -> Result<()> {
    print(&format!("{}\n", serde_json::to_string_pretty(value)?))
}

/// Prints `value` as JSON, or `text` for people.
pub fn print_either(as_json: bool, value: &impl Serialize, text: &str) -> Result<()> {
    if as_json { print_json(value) } else { print(text) }
}

/// Holds the file that a report goes to, if it does, before what is reported is done.
pub fn hold_report(file: Option<&Path>) -> Result<Option<Hold>> {
    Ok(file.filter(|file| *file != Path::new("-")).map(hold_file).transpose()?.flatten())
}

/// Prints `text` for people, and writes `report` as JSON to `file`. If that is `-`, the report goes to standard output, and the
/// text to standard error.
pub fn print_report(file: Option<&Path>, report: &impl Serialize, text: &str) -> Result<()> {
    match file {
        Some(file) if file == Path::new("-") => {
            // The text is for people: if nobody can read it, the result is still on standard output.
            let _ = std::io::stderr().write_all(text.as_bytes());
            return print_json(report);
        }
        Some(file) => write_json(file, report)?,
        None => {}
    }
    print(text)
}

/// Left-aligned names, values behind them.
pub fn table(rows: &[(&str, String)]) -> String {
    let width = rows.iter().map(|(name, _)| name.chars().count()).max().unwrap_or(0);
    rows.iter().map(|(name, value)| format!("{name:width$}  {value}\n")).collect()
}
