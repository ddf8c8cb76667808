//! `dpges compare`: methods on the same data, with equal steps, budgets and seeds.

mod lpips;
mod method;
mod popping;
mod report;
mod sheets;

use clap::Args;
use dpges_train::config::{Budget, Config};
use dpges_train::run::budget;

use super::series::{Member, SeriesArgs};
use crate::cli::device_failure::watched;
use crate::cli::logging::LogStyle;
use crate::cli::lpips::LpipsArgs;
use crate::cli::{Failure, Result, print};
use method::Method;
use report::Comparison;

/// Train several methods on the same data and compare them
///
/// Each method is a run for each seed, in a folder of its own, with the same data, steps and largest number of primitives:
/// `refine.budget` as a number, which without --budget is what `pixels` stands for. The same command again skips finished
/// runs and resumes one that was interrupted. The comparison is printed as a table in Markdown and written to
/// comparison.csv, comparison.json, comparison.svg and, for up to three held-out views, pictures/VIEW.png.
///
/// Without DATASET the built-in scene is used, with the defaults of `dpges train`.
#[derive(Debug, Args)]
pub struct CompareArgs {
    /// Methods to compare, separated by commas, in this order; others are compared with the first [default: all]
    #[arg(long, value_name = "METHOD", value_enum, value_delimiter = ',')]
    methods: Vec<Method>,
    /// Print all methods as a table in Markdown, and train nothing
    #[arg(long)]
    list: bool,
    #[command(flatten)]
    lpips: LpipsArgs,
    /// Measure popping of every run: FLIP between frames of a short path that are 1 and 7 apart, where the motion of the
    /// camera does not explain it
    #[arg(long)]
    popping: bool,
    #[command(flatten)]
    series: SeriesArgs,
}

pub fn run(args: &CompareArgs, style: LogStyle) -> Result<()> {
    if args.list {
        return print(&Method::list());
    }
    let methods = Method::chosen(&args.methods);
    let (source, out) = (args.series.source(), args.series.out());
    let config = args.config()?;
    let common = args.series.load(source, &config, style)?;
    let budget = budget(&config, &common.dataset);
    let members = members(&methods, budget);
    let series = args.series.series(&common.source, &members)?;
    let networks = args.lpips.load(&common.device)?;
    series.train(&common)?;
    watched(common.name, || {
        lpips::measure(out, &series.rows()?, &common, &networks)?;
        if args.popping {
            popping::measure(out, &series.rows()?, &common)?;
        }
        let rows = series.rows()?;
        let pictures = sheets::write(out, &rows, &common)?;
        let comparison = Comparison::new(&common.source, config.train.steps, budget, &members, rows, pictures);
        let files = comparison.write(out)?;
        if style == LogStyle::Quiet { Ok(()) } else { print(&(comparison.table() + "\n" + &files)) }
    })
}

impl CompareArgs {
    /// The configuration that all methods begin with.
    ///
    /// # Errors
    /// If it says what only a comparison can say: which method, or a budget that each method would decide for itself.
    fn config(&self) -> Result<Config> {
        if self.series.options.names_method() {
            let message = "--method names one method to train: name those to compare with --methods";
            return Err(Failure::Usage(message.to_owned()));
        }
        let config = self.series.config(&self.series.source(), &["train.method=dpges".to_owned()])?;
        if config.refine.budget == Budget::Auto {
            let message = "`refine.budget` is \"auto\", but methods are compared with one number of primitives for all: \
                           --budget N, NMB or pixels";
            return Err(Failure::Usage(message.to_owned()));
        }
        Ok(config)
    }
}

/// The methods with a budget of so many primitives for each.
fn members(methods: &[Method], budget: usize) -> Vec<Member> {
    let budget = format!("refine.budget={budget}");
    let member = |method: &Method| {
        let settings = [&method.settings()[..], std::slice::from_ref(&budget)].concat();
        Member { label: method.name, settings }
    };
    methods.iter().map(member).collect()
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;

    #[derive(Debug, Parser)]
    struct Command {
        #[command(flatten)]
        compare: CompareArgs,
    }

    fn parsed(arguments: &[&str]) -> Result<CompareArgs, clap::Error> {
        Ok(Command::try_parse_from([&["compare", "--out=a"], arguments].concat())?.compare)
    }

    fn refused(arguments: &[&str]) -> String {
        match parsed(arguments).unwrap().config() {
            Err(Failure::Usage(message)) => message,
            _ => panic!("not refused"),
        }
    }

    #[test]
    fn what_methods_must_share_is_not_left_to_them() {
        assert!(refused(&["--method=mcmc"]).contains("--methods"));
        assert!(refused(&["--budget=auto"]).contains("--budget N"));
        assert!(parsed(&["--budget=12MB"]).unwrap().config().is_ok());
        let unknown = parsed(&["--methods=dpges,3dgz"]).unwrap_err().to_string();
        assert!(unknown.contains("3dgz") && unknown.contains("[possible values: dpges"), "{unknown}");
    }

    #[test]
    fn all_methods_have_the_same_budget() {
        for member in members(&Method::chosen(&[]), 1234) {
            let config = Config::resolve(None, None, &member.settings).unwrap();
            assert_eq!(config.refine.budget, Budget::Primitives(1234), "{}", member.label);
        }
    }
}
