//! `dpges ablate`: the method, and the method without one of its parts, on the same data for the same steps.

use clap::Args;
use clap::builder::PossibleValuesParser;
use dpges_lab::study::ablate::{METHOD, SHAPE, VARIANTS, chosen};
use dpges_lab::study::store::Study;
use dpges_lab::study::variant::Variant;
use serde_json::{Map, Value};

use super::{StudyArgs, choices};
use crate::logging::LogStyle;
use crate::{Result, print};

/// Train the method and its ablations one after another, and compare them
///
/// Each variant is a run for each seed, in a folder of its own, with the same data and steps. The same command again skips
/// finished runs and resumes one that was interrupted. The comparison is printed as a table in Markdown and written to
/// ablation.csv, ablation.json, plots, report.html and, for up to three held-out views, pictures/VIEW.png; with several
/// seeds it gives means and sample standard deviations.
///
/// Without DATASET the built-in scene is used, with the defaults of `dpges train`.
#[derive(Debug, Args)]
pub struct AblateArgs {
    /// Variants to train, separated by commas [default: those of the paper's table that change the configuration]
    #[arg(long, value_name = "VARIANT", value_delimiter = ',', value_parser = PossibleValuesParser::new(choices(&VARIANTS)))]
    only: Vec<String>,
    /// Print all variants as a table in Markdown, and train nothing
    #[arg(long)]
    list: bool,
    #[command(flatten)]
    study: StudyArgs,
}

pub fn run(args: &AblateArgs, style: LogStyle) -> Result<()> {
    if args.list {
        return print(&Variant::list(&VARIANTS, ["variant", "what changes", "keys"]));
    }
    let config = args.study.config(&[])?;
    let (variants, equal) = chosen(&args.only, |more| args.study.config(more))?;
    let training = args.study.load(&config, style)?;
    let subject = Map::from_iter([
        ("dataset".to_owned(), Value::from(training.source.to_string())),
        ("steps".to_owned(), Value::from(config.train.steps)),
    ]);
    let mut study = Study::new(&SHAPE, args.study.out(), subject);
    study.content.notes.push(format!("{}: held-out views, {} steps.", training.source, config.train.steps));
    if !equal.is_empty() {
        let left_out = format!("Left out, since the configuration is that of {METHOD}: {}.", equal.join(", "));
        tracing::info!("{left_out}");
        study.content.notes.push(left_out);
    }
    args.study.conduct(study, &variants, training)
}
