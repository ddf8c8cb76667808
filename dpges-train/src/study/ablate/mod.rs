//! `dpges ablate`: the method, and the method without one of its parts, on the same data for the same steps.

mod report;
mod variant;

use clap::Args;

use super::series::{Member, SeriesArgs};
use crate::cli::logging::LogStyle;
use crate::cli::{Result, print};
use variant::Variant;

/// Train the method and its ablations one after another, and compare them
///
/// Each variant is a run for each seed, in a folder of its own, with the same data and steps. The same command again skips
/// finished runs and resumes one that was interrupted. The comparison is written to ablation.csv and ablation.svg; with
/// several seeds it gives means and sample standard deviations.
///
/// Without DATASET the built-in scene is used, with the defaults of `dpges train`.
#[derive(Debug, Args)]
pub struct AblateArgs {
    /// Variants to train, separated by commas, instead of those of the paper's table
    #[arg(long, value_name = "VARIANT", value_enum, value_delimiter = ',')]
    only: Vec<Variant>,
    /// Print all variants as a table in Markdown, and train nothing
    #[arg(long)]
    list: bool,
    #[command(flatten)]
    series: SeriesArgs,
}

pub fn run(args: &AblateArgs, style: LogStyle) -> Result<()> {
    if args.list {
        return print(&Variant::list());
    }
    let source = args.series.source();
    let member = |variant: Variant| Member { label: variant.name, settings: variant.settings() };
    let members: Vec<Member> = Variant::chosen(&args.only).into_iter().map(member).collect();
    let series = args.series.series(&source, &members)?;
    if !series.is_finished() {
        series.train(&args.series.load(source, series.first_config(), style)?)?;
    }
    let rows = series.rows()?;
    let files = report::write(args.series.out(), &rows)?;
    if style == LogStyle::Quiet { Ok(()) } else { print(&(report::table(&rows) + &files)) }
}
