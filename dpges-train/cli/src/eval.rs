//! `dpges eval`: image quality of a scene against photographs.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use clap::Args;
use dpges_train::device::DeviceName;
use dpges_train::device::memory::peak_memory_bytes;
use dpges_train::eval::pictures::{file_stems, save_png};
use dpges_train::eval::popping::Measured;
use dpges_train::eval::rendered::{TrainingRenderer, to_picture};
use dpges_train::eval::worst;
use dpges_train::eval::{EvalReport, FrameMs, Measures, evaluate_each};
use dpges_train::run::hold::{Hold, check_report};

use super::data::{Scene, ViewArgs};
use super::device_choice::{DeviceArgs, watched};
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
    /// Also measure PSNR and SSIM after a fit of exposure: of the right half of each view, with a gain and an offset per
    /// channel that fit its left half best. The default for runs that correct exposures
    #[arg(long)]
    fit_exposure: bool,
    /// Also measure PSNR and SSIM after a fit of the camera: of the right half of each view, from where the camera has to be
    /// for the left half to fit best. Renders each view 80 times more
    #[arg(long)]
    fit_poses: bool,
    /// Write the rendered views as PNGs to this folder
    #[arg(long, value_name = "DIR")]
    save_images: Option<PathBuf>,
    /// Write the view that each metric finds worst to this folder, as worst_METRIC.png: photograph, render and FLIP side by
    /// side. With --popping also the frames that pop most, as worst_flip_1.png and worst_flip_7.png: the earlier frame as the
    /// motion of the camera moves it, the later one, and FLIP
    #[arg(long, value_name = "DIR")]
    worst: Option<PathBuf>,
    /// Also measure popping: FLIP between frames of a short path that are 1 and 7 apart, where the motion of the camera does
    /// not explain it; and jumps: how often a pixel changes by more than 8 and 16 of 256 levels from one frame to the next
    /// along an arc of 6° in small steps. Renders 60 frames and up to 1,920
    #[arg(long)]
    popping: bool,
    /// Also measure the frame times of the real-time renderer, over up to 16 of the views at the size of the first. Of scenes
    /// of --method sss and sortfree, which it does not draw, those of the renderer that is trained with
    #[arg(long)]
    frame_times: bool,
    /// Write the result to this file; `-` is standard output
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
}

pub fn run(args: &EvalArgs) -> Result<()> {
    let folders: BTreeSet<&PathBuf> = args.save_images.iter().chain(&args.worst).collect();
    let holds = folders.into_iter().map(|folder| Hold::of_folder(folder)).collect::<Result<Vec<Hold>, _>>()?;
    let _held = hold_report(args.json.as_deref())?;
    let scene = Scene::load(&args.scene)?;
    let device = args.device.select()?;
    watched(device, || measure(args, &holds, scene, device))
}

fn measure(args: &EvalArgs, holds: &[Hold], mut scene: Scene, device: DeviceName) -> Result<()> {
    let device_name = device.to_string();
    let device = device.open()?;
    let networks = args.lpips.load(&device)?;
    let choice = args.views.choice();
    let (source, dataset) = choice.load_dataset(&mut scene)?;
    let views = choice.chosen(&dataset);
    let stems = file_stems(views.iter().map(|view| &*view.name));
    if let Some(hold) = holds.iter().find(|hold| Some(hold.folder()) == args.save_images.as_deref()) {
        hold.add_files(stems.iter().map(|stem| format!("{stem}.png")))?;
    }
    args.json.iter().try_for_each(|file| check_report(file, &source))?;
    let renderer = TrainingRenderer::new(&scene.data, &device);
    let fitted = args.fit_exposure || scene.has_exposure();
    let measures = Measures { fitted, posed: args.fit_poses, ..Measures::perceptual(&networks) };
    let evaluation = evaluate_each(&renderer, &scene.data, views, &device, measures, |index, render| {
        let Some(folder) = &args.save_images else { return Ok(()) };
        save_png(&to_picture(render.image()), &folder.join(format!("{}.png", stems[index])))
    })?;
    let popping = if args.popping { Measured::of_scene(&renderer, &dataset, &scene.data.info)? } else { None };
    let mut worst = Vec::new();
    if let Some(folder) = &args.worst {
        worst.extend(worst::write(folder, &evaluation, views, &renderer)?);
        for frame in popping.iter().flat_map(|measured| &measured.worst) {
            worst.push(format!("{frame}, {}", frame.save(folder)?.display()));
        }
    }
    let mut notes = Vec::new();
    if args.popping && popping.is_none() {
        notes.push(("popping", "not measured: no surface is seen from two frames".to_owned()));
    }
    let mut frame_ms = None;
    if args.frame_times {
        match FrameMs::measure(&scene.data, views, &renderer, &device_name) {
            Ok(times) => frame_ms = Some(times),
            Err(error) => notes.push(("frames", format!("not measured: {error}"))),
        }
    }
    if args.lpips.is_empty() && networks.is_empty() {
        notes.push(("LPIPS", "not measured: tools/lpips_weights.py makes the network for it".to_owned()));
    }
    let report = EvalReport {
        scene: scene.path.display().to_string(),
        dataset: source.to_string(),
        split: choice.split().to_string(),
        evaluation,
        bytes: scene.bytes,
        floaters: renderer.floaters(&dataset)?,
        training_seconds: scene.training_seconds()?,
        peak_memory_bytes: peak_memory_bytes(),
        target: None,
        popping: popping.map(|measured| measured.popping),
        frame_ms,
    };
    let summary = table(&report.rows(&worst, notes));
    print_report(Some(args.json.as_deref().unwrap_or(Path::new("-"))), &report, &summary)
}
