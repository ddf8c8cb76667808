//! `dpges compare`: methods on the same data, with equal steps, budgets and seeds.

use clap::Args;
use clap::builder::PossibleValuesParser;
use dpges_lab::study::compare::{METHODS, SHAPE, chosen};
use dpges_lab::study::store::Study;
use dpges_lab::study::variant::Variant;
use dpges_train::config::{Budget, Config};
use dpges_train::run::budget;
use serde_json::{Map, Value};

use super::{StudyArgs, choices};
use crate::logging::LogStyle;
use crate::{Failure, Result, print};

/// Train several methods on the same data and compare them
///
/// Each method is a run for each seed, in a folder of its own, with the same data, steps and largest number of primitives:
/// `refine.budget` as a number, which without --budget is what `pixels` stands for. The same command again skips finished
/// runs and resumes one that was interrupted. The comparison is printed as a table in Markdown and written to
/// comparison.csv, comparison.json, plots, report.html and, for up to three held-out views, pictures/VIEW.png.
///
/// Without DATASET the built-in scene is used, with the defaults of `dpges train`.
#[derive(Debug, Args)]
pub struct CompareArgs {
    /// Methods to compare, separated by commas, in this order; others are compared with the first [default: all]
    #[arg(long, value_name = "METHOD", value_delimiter = ',', value_parser = PossibleValuesParser::new(choices(&METHODS)))]
    methods: Vec<String>,
    /// Print all methods as a table in Markdown, and train nothing
    #[arg(long)]
    list: bool,
    #[command(flatten)]
    study: StudyArgs,
}

pub fn run(args: &CompareArgs, style: LogStyle) -> Result<()> {
    if args.list {
        return print(&Variant::list(&METHODS, ["method", "what is trained", "keys"]));
    }
    let config = args.config()?;
    let training = args.study.load(&config, style)?;
    let (steps, budget) = (config.train.steps, budget(&config, &training.dataset));
    let methods = chosen(&args.methods, budget);
    let subject = Map::from_iter([
        ("dataset".to_owned(), Value::from(training.source.to_string())),
        ("steps".to_owned(), Value::from(steps)),
        ("budget".to_owned(), Value::from(budget)),
    ]);
    let mut study = Study::new(&SHAPE, args.study.out(), subject);
    let conditions = format!("{}: held-out views, {steps} steps, at most {budget} primitives.", training.source);
    study.content.notes.push(conditions);
    args.study.conduct(study, &methods, training)
}

impl CompareArgs {
    /// The configuration that all methods begin with.
    ///
    /// # Errors
    /// If it says what only a comparison can say: which method, or a budget that each method would decide for itself.
    fn config(&self) -> Result<Config> {
        if self.study.options.names_method() {
            let message = "--method names one method to train: name those to compare with --methods";
            return Err(Failure::Usage(message.to_owned()));
        }
        let config = self.study.config(&["train.method=dpges".to_owned()])?;
        if config.refine.budget == Budget::Auto {
            let message = "`refine.budget` is \"auto\", but methods are compared with one number of primitives for all: \
                           --budget N, NMB or pixels";
            return Err(Failure::Usage(message.to_owned()));
        }
        Ok(config)
    }
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
        assert!(parsed(&["--seeds=0"]).unwrap_err().to_string().contains("--seeds"));
    }
}
