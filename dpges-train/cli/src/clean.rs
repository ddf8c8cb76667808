//! `dpges clean`: a scene without its waste.

use std::path::PathBuf;

use clap::Args;
use dpges_train::dataset::block::Bounds;
use dpges_train::eval::simplify::clean::{Report, Rules, clean, size};
use dpges_train::run::folder::hold_file;

use super::compress::refuse_same_file;
use super::data::{Scene, ViewArgs};
use super::device_choice::{DeviceArgs, watched};
use super::{Result, hold_report, print_report, table};

/// Write a scene without what floats, what no training camera sees, what is outside of a box, and what is oversized
///
/// The dataset, that of the run or --data, tells floaters and what nobody sees. Then the PSNR of its held-out views is printed
/// before and after, and NAME_before.png and NAME_after.png beside the new scene show the view that changes most.
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
    /// Remove all whose centres are outside, in coordinates of the scene, world units
    #[arg(long = "box", value_name = "X0,Y0,Z0,X1,Y1,Z1", allow_hyphen_values = true)]
    bounds: Option<Bounds>,
    /// Remove all of which a scale (standard deviation) is larger, world units; `dpges info` prints percentiles
    #[arg(long, value_name = "SIZE", allow_hyphen_values = true, value_parser = size)]
    largest: Option<f64>,
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
    let _held = (out.map(hold_file).transpose()?, hold_report(args.json.as_deref())?);
    let mut scene = Scene::load(&args.scene)?;
    out.map_or(Ok(()), |out| refuse_same_file(out, &scene))?;
    let rules = Rules { bounds: args.bounds, largest: args.largest };
    let print = |report: &Report, unknown: Option<&str>| {
        print_report(args.json.as_deref(), report, &table(&report.rows(unknown)))
    };
    let needs_dataset = choice.data.is_some() || (rules.bounds.is_none() && rules.largest.is_none());
    match choice.dataset(&mut scene) {
        Ok((source, dataset)) => {
            let device = args.device.select()?;
            watched(device, || {
                let known = Some((&source, &dataset, &device.open()?));
                print(&clean(&scene.data, &scene.path, &rules, known, choice.split(), out)?, None)
            })
        }
        Err(error) if needs_dataset => Err(error.into()),
        Err(error) => {
            let report = clean(&scene.data, &scene.path, &rules, None, choice.split(), out)?;
            print(&report, Some(&error.to_string()))
        }
    }
}
