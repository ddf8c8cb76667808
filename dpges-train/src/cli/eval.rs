//! `dpges eval`: image quality of a scene against photographs.

use std::io::Write;
use std::path::{Path, PathBuf};

use clap::Args;
use dpges_core::Error;
use dpges_train::device::{DeviceName, DeviceRequest};
use dpges_train::eval::{EvalReport, Evaluation, evaluate_each};
use dpges_train::pictures::{file_stems, save_png};
use dpges_train::rendered::{Renderer, to_picture};
use dpges_train::run::folder::write_json;
use dpges_train::sight::Floaters;

use super::data::{Scene, ViewArgs};
use super::device_failure::watched;
use super::{Result, device_choice, print, table};

/// Measure PSNR, SSIM and FLIP of a scene against photographs
///
/// Prints the result as JSON on standard output and as a table on standard error. With --json FILE, the JSON goes to
/// the file and the table to standard output.
#[derive(Debug, Args)]
pub struct EvalArgs {
    /// Scene file or folder of a run
    scene: PathBuf,
    #[command(flatten)]
    views: ViewArgs,
    /// auto (a GPU that passes a check, or else the CPU), cpu, cpu-flex, wgpu (the best GPU), or another one that
    /// `dpges devices` lists
    #[arg(long, value_name = "NAME", default_value_t)]
    device: DeviceRequest,
    /// Write the rendered views as PNGs to this folder
    #[arg(long, value_name = "DIR")]
    save_images: Option<PathBuf>,
    /// Write the result to this file; `-` is standard output
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
}

pub fn run(args: &EvalArgs) -> Result<()> {
    let scene = Scene::load(&args.scene)?;
    let device = device_choice::select(args.device)?;
    watched(device, || measure(args, scene, device))
}

fn measure(args: &EvalArgs, mut scene: Scene, device: DeviceName) -> Result<()> {
    let (source, dataset) = args.views.load_dataset(&mut scene)?;
    let views = args.views.chosen(&dataset);
    if let Some(folder) = &args.save_images {
        make_folder(folder)?;
    }
    let device = device.open()?;
    let stems = file_stems(views);
    let renderer = Renderer::new(&scene.data, &device);
    let evaluation = evaluate_each(&renderer, &scene.data, views, &device, |index, render| {
        let Some(folder) = &args.save_images else { return Ok(()) };
        save_png(&to_picture(render.image()), &folder.join(format!("{}.png", stems[index])))
    })?;
    let report = EvalReport {
        scene: scene.path.display().to_string(),
        dataset: source.to_string(),
        split: args.views.split.to_string(),
        evaluation,
        bytes: scene.bytes,
        floaters: renderer.floaters(&dataset)?,
        target: None,
    };
    match args.json.as_deref().filter(|path| *path != Path::new("-")) {
        Some(path) => {
            write_json(path, &report)?;
            print(&summary(&report))
        }
        None => {
            // The table is for people: if nobody can read it, the result is still on standard output.
            let _ = std::io::stderr().write_all(summary(&report).as_bytes());
            print(&format!("{}\n", serde_json::to_string_pretty(&report)?))
        }
    }
}

/// # Errors
/// [`Error::Io`] naming `path`.
pub fn make_folder(path: &Path) -> Result<(), Error> {
    std::fs::create_dir_all(path).map_err(|source| Error::Io {
        action: "cannot make folder",
        path: path.to_owned(),
        source,
    })
}

fn summary(report: &EvalReport) -> String {
    let Evaluation { views, psnr, ssim, flip, surfels, gaussians, seconds_per_view } = &report.evaluation;
    let scores = |psnr: f64, ssim: f64, flip: f64| format!("{psnr:.2} dB  {ssim:.4}  {flip:.4}");
    let mut rows: Vec<(&str, String)> =
        views.iter().map(|view| (view.name.as_str(), scores(view.psnr, view.ssim, view.flip))).collect();
    rows.push(("mean", scores(*psnr, *ssim, *flip)));
    rows.push(("scene", format!("{surfels} surfels, {gaussians} Gaussians, {:.1} MB", report.bytes as f64 / 1e6)));
    if let Some(Floaters { surfels, gaussians }) = report.floaters {
        rows.push(("floaters", format!("{surfels} surfels, {gaussians} Gaussians")));
    }
    rows.push(("rendering", format!("{:.1} ms per view", 1e3 * seconds_per_view)));
    table(&rows)
}
