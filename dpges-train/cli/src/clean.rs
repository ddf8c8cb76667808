//! `dpges clean`: a scene without its waste.

use std::path::PathBuf;

use clap::Args;
use dpges_train::run::clean::{Known, Rules, clean};

use super::data::{ViewArgs, open_to_write};
use super::device_choice::{DeviceArgs, select, watched};
use super::{Result, print_report, table};

/// Write a scene without what no training camera sees, and where asked to without what is outside of a box, oversized or floats
///
/// The dataset, that of the run or --data, tells what nobody sees, which costs nothing, and floaters, which were trained to help.
/// The PSNR of its held-out views is printed before and after, and NAME_before.png and NAME_after.png beside the new scene show
/// the view that changes most.
#[derive(Debug, Args)]
pub struct CleanArgs {
    /// Scene file, splats (PLY, SPZ, glTF) or folder of a run
    scene: PathBuf,
    /// Scene file to write
    #[arg(long, value_name = "FILE", required_unless_present = "dry_run")]
    out: Option<PathBuf>,
    /// Only count what would go
    #[arg(long, conflicts_with = "out")]
    dry_run: bool,
    #[command(flatten)]
    rules: Rules,
    #[command(flatten)]
    views: ViewArgs,
    #[command(flatten)]
    device: DeviceArgs,
    /// Write the result to this file; `-` is standard output
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
}

pub fn run(args: &CleanArgs) -> Result<()> {
    let (out, choice) = (args.out.as_deref(), args.views.choice());
    let (mut scene, _held) = open_to_write(&args.scene, out, args.json.as_deref())?;
    let rules = &args.rules;
    let known = choice.dataset_at_hand(&mut scene, rules.need_dataset())?;
    let clean = |known: Known<'_>| {
        let report = clean(&scene.data, &scene.path, rules, known, choice.split(), out)?;
        print_report(args.json.as_deref(), &report, &table(&report.rows()))
    };
    match &known {
        Ok((source, dataset)) => {
            let device = select(args.device.request)?;
            watched(device, || clean(Ok((source, dataset, &device.open()?))))
        }
        Err(error) => clean(Err(error.to_string())),
    }
}
