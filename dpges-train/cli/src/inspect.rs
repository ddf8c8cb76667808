//! `dpges data`: what a dataset is, and whether it will do.

use std::io::Write;
use std::path::PathBuf;

use clap::Args;
use dpges_core::scene::atomic::write_atomically;
use dpges_train::config::{Config, key};
use dpges_train::dataset::capture;
use dpges_train::dataset::check::{Effort, Report, map, sheet, summary};
use dpges_train::device::DeviceRequest;
use dpges_train::eval::pictures::{photograph, save_png};
use dpges_train::init::chance::random_points;
use dpges_train::run::folder::write_json;
use dpges_train::run::hold::Hold;
use dpges_train::run::recommendation::{PRESET, Recommendation};
use serde::Serialize;

use super::data::{DataArgs, Source, absolute, assigned};
use super::train::options::of_dataset;
use super::{Result, device_choice, hold_report, print, sfm, table};
use crate::logging::LogStyle;

/// Check a dataset: what it consists of, and which photographs will harm the result
///
/// Names photographs that are blurred, brighter or darker than the rest, or there twice, and cameras that are far from all
/// others, do not fit their points or see none. Photographs are judged in the size in which they are trained on. `dpges train` prints what is
/// found too. Ends with the command to train with on this machine, and a reason for each of its settings.
#[derive(Debug, Args)]
pub struct InspectArgs {
    /// Folder of a COLMAP, Blender or nerfstudio dataset, or `builtin`; or photographs or a video, see `dpges sfm`
    dataset: PathBuf,
    /// Write all numbers to a JSON file
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
    /// Write a contact sheet, with what was found and what is masked marked, and a map of cameras and points to a folder
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    #[arg(long, value_name = "FILE", help = key("data.points").help())]
    points: Option<PathBuf>,
    #[command(flatten)]
    options: DataArgs,
}

/// The content of the JSON file.
#[derive(Serialize)]
struct Inspected<'a> {
    #[serde(flatten)]
    report: &'a Report,
    recommendation: &'a Recommendation,
}

pub fn run(args: &InspectArgs, style: LogStyle) -> Result<()> {
    let _held = (args.out.as_deref().map(Hold::of_folder).transpose()?, hold_report(args.json.as_deref())?);
    let points = assigned([("data.points", args.points.as_deref().map(absolute))]);
    let set = [args.options.assignments(), points].concat();
    let config = Config::resolve_data(None, &set)?;
    let options = capture::Options { invert_masks: config.invert_masks, ..capture::Options::default() };
    sfm::prepare(Some(&args.dataset), &options, style)?;
    let source = Source::named(Some(&args.dataset));
    let dataset = source.load(&config.load_options())?;
    let mut report = Report::of(&dataset, Effort::Full)?;
    report.findings.extend(random_points(&dataset)?);
    let mut rows = vec![("dataset", format!("{source}: {}", dataset.format))];
    rows.extend(summary::rows(&dataset, &report));
    let findings: String = report.findings.iter().map(|finding| format!("! {finding}\n")).collect();
    let findings = if findings.is_empty() { "Nothing is wrong with it.\n" } else { &findings };
    let notes: String = report.notes.iter().map(|note| format!("  {note}\n")).collect();
    print(&format!("{}\nNumbers are medians, with the 5th and 95th percentile.\n\n{notes}{findings}", table(&rows)))?;
    let device = device_choice::select(DeviceRequest::Auto)?;
    let run = Config::resolve_for(of_dataset(&source), Some(PRESET), None, &set)?;
    let recommendation = Recommendation::new(&source, &set, &dataset, &run, &device.open()?, &device.to_string())?;
    print(&format!("\nRecommended: {}\n{}", recommendation.command, table(&recommendation.settings)))?;
    if let Some(path) = &args.json {
        write_json(path, &Inspected { report: &report, recommendation: &recommendation })?;
    }
    if let Some(out) = &args.out {
        let (sheet, map) = (out.join("contact_sheet.png"), out.join("cameras.svg"));
        save_png(&photograph(&sheet::contact_sheet(&dataset, &report)?), &sheet)?;
        write_atomically(&map, |file| file.write_all(map::svg(&dataset, &report).as_bytes()))?;
        print(&format!("\n{}\n{}\n", sheet.display(), map.display()))?;
    }
    Ok(())
}
