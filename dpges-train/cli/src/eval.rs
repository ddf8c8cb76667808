//! `dpges eval`: image quality of a scene against photographs.

use std::path::{Path, PathBuf};

use clap::Args;
use dpges_train::device::DeviceName;
use dpges_train::device::memory::peak_memory_bytes;
use dpges_train::eval::EvalReport;
use dpges_train::eval::plan::{Found, Plan};
use dpges_train::eval::rendered::TrainingRenderer;
use dpges_train::metrics::lpips::choice::load;
use dpges_train::run::hold::{Hold, check_report};

use super::data::{Scene, ViewArgs};
use super::device_choice::{DeviceArgs, select, watched};
use super::lpips::LpipsArgs;
use super::{Result, hold_report, print_report, table};

/// Measure PSNR, SSIM, FLIP, MS-SSIM, SSIMULACRA2 and LPIPS of a scene against photographs
///
/// Prints the result as JSON on standard output and as a table on standard error. With --json FILE, the JSON goes to
/// the file and the table to standard output. A metric that does not fit the size of the pictures is left out, and so is
/// LPIPS without a network.
#[derive(Debug, Args)]
pub struct EvalArgs {
    /// Scene file, splats (PLY, SPZ, SOG, glTF) or folder of a run
    scene: PathBuf,
    #[command(flatten)]
    views: ViewArgs,
    #[command(flatten)]
    device: DeviceArgs,
    #[command(flatten)]
    lpips: LpipsArgs,
    #[command(flatten)]
    plan: Plan,
    /// Write the result to this file; `-` is standard output
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
}

pub fn run(args: EvalArgs) -> Result<()> {
    let holds = args.plan.folders().into_iter().map(|folder| Hold::of_folder(folder)).collect::<Result<Vec<_>, _>>()?;
    let _held = hold_report(args.json.as_deref())?;
    let scene = Scene::load(&args.scene)?;
    let device = select(args.device.request)?;
    watched(device, || measure(args, &holds, scene, device))
}

fn measure(args: EvalArgs, holds: &[Hold], mut scene: Scene, name: DeviceName) -> Result<()> {
    let EvalArgs { mut plan, views, lpips, json, .. } = args;
    let (choice, device) = (views.choice(), &name.open()?);
    let networks = &load(&lpips.chosen, device)?;
    let (source, dataset) = &choice.load_dataset(&mut scene)?;
    let views = choice.chosen(dataset);
    if let Some(hold) = holds.iter().find(|hold| Some(hold.folder()) == plan.save_images.as_deref()) {
        hold.add_files(Plan::files(views))?;
    }
    json.iter().try_for_each(|file| check_report(file, source))?;
    plan.fit_exposure |= scene.has_exposure();
    let renderer = &TrainingRenderer::new(&scene.data, device);
    let found = plan.measure(&scene.data, renderer, dataset, views, networks, &name.to_string())?;
    let Found { evaluation, popping, frame_ms, worst, mut notes } = found;
    if lpips.chosen.is_empty() && networks.is_empty() {
        notes.push(("LPIPS", "not measured: tools/lpips_weights.py makes the network for it".to_owned()));
    }
    let report = EvalReport {
        scene: scene.path.display().to_string(),
        dataset: source.to_string(),
        split: choice.split().to_string(),
        evaluation,
        bytes: scene.bytes,
        floaters: renderer.floaters(dataset)?,
        training_seconds: scene.training_seconds()?,
        peak_memory_bytes: peak_memory_bytes(),
        target: None,
        popping,
        frame_ms,
    };
    let summary = table(&report.rows(&worst, notes));
    print_report(Some(json.as_deref().unwrap_or(Path::new("-"))), &report, &summary)
}
