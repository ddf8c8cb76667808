//! `dpges compress`: a scene in fewer bytes.

use std::io::Write;
use std::path::PathBuf;

use clap::Args;
use dpges_core::scene::atomic::write_atomically;
use dpges_core::scene::{Quality, SceneData};
use dpges_train::dataset::View;
use dpges_train::eval::compress::report::{Psnr, Report};
use dpges_train::eval::compress::{Goal, Measure, bytes, decibels, levels};
use dpges_train::eval::evaluate;

use super::data::{Scene, Source, Split, ViewArgs, every_nth, open_to_write};
use super::device_choice::{DeviceArgs, select, watched};
use super::{Failure, Result, print_report, table};

/// Most views that decide on a loss.
const DECIDING_VIEWS: usize = 32;

/// Write a scene in fewer bytes, which all commands and the viewers read like any other
///
/// If the dataset is at hand, the PSNR of its held-out views is printed before and after. A largest loss is that of views
/// which the run of the scene kept for its decisions, or of training views, and then theirs is printed. The file may have
/// any name; dialogs to open a scene list *.safetensors.
#[derive(Debug, Args)]
#[command(mut_arg("split", |split| split.help("Which views [default: test; with a largest loss validation, or train]")))]
pub struct CompressArgs {
    /// Scene file, splats (PLY, SPZ, SOG, glTF) or folder of a run
    scene: PathBuf,
    /// File to write
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    /// How exact numbers are [default: medium]
    #[arg(long, value_name = "LEVEL", value_parser = levels())]
    quality: Option<Quality>,
    /// Instead of a quality: the largest size of the file, as in 10MB, for which the best level is found
    #[arg(long, value_name = "NMB", value_parser = bytes, conflicts_with = "quality")]
    budget: Option<usize>,
    /// Instead of a quality: the largest loss of PSNR, as in 0.1dB, for which the smallest level is found. Renders up to 32
    /// views a few times
    #[arg(long, value_name = "LOSS", value_parser = decibels, conflicts_with_all = ["quality", "budget"])]
    target: Option<f64>,
    #[command(flatten)]
    views: ViewArgs,
    #[command(flatten)]
    device: DeviceArgs,
    /// Write the result to this file; `-` is standard output
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
}

pub fn run(args: &CompressArgs) -> Result<()> {
    let (mut scene, _held) = open_to_write(&args.scene, Some(&args.out), args.json.as_deref())?;
    match args.measured(&mut scene) {
        Ok((source, split, views)) => {
            let device = select(args.device.request)?;
            watched(device, || {
                let device = device.open()?;
                let psnr = |scene: &SceneData| Ok(evaluate(scene, &views, &device)?.psnr);
                let psnr_of = |[psnr_before, psnr_after]: [f64; 2]| {
                    let (dataset, split, views) = (source.to_string(), split.to_string(), views.len());
                    Psnr { dataset, split, views, psnr_before, psnr_after }
                };
                args.compress(&scene, Some(&psnr), |psnr| psnr.map(psnr_of), "")
            })
        }
        Err(failure) if args.views.choice().data.is_some() => Err(failure),
        Err(failure) => match args.target {
            Some(allowed) => {
                let message = format!("--target {allowed}dB compares with photographs: {}", failure.text());
                Err(Failure::Usage(message))
            }
            None => args.compress(&scene, None, |_| None, &failure.text()),
        },
    }
}

impl CompressArgs {
    /// The views that are measured, of which split they are, and what they were read from.
    fn measured(&self, scene: &mut Scene) -> Result<(Source, Split, Vec<View>)> {
        let choice = self.views.choice();
        if self.target.is_none() {
            let (source, views) = choice.load(scene)?;
            return Ok((source, choice.split(), views));
        }
        let (source, dataset, split) = choice.load_to_decide(scene)?;
        Ok((source, split, every_nth(split.of(&dataset), DECIDING_VIEWS).cloned().collect()))
    }

    /// Writes the compressed scene and the report. `psnr` completes what `measure` found; `not_measured` says why there is none.
    fn compress(
        &self,
        scene: &Scene,
        measure: Option<&Measure>,
        psnr: impl FnOnce(Option<[f64; 2]>) -> Option<Psnr>,
        not_measured: &str,
    ) -> Result<()> {
        let (data, out) = (&scene.data, &self.out);
        let goal = match (self.budget, self.target) {
            (Some(largest), _) => Goal::Bytes(largest),
            (None, Some(allowed)) => Goal::Loss(allowed),
            (None, None) => Goal::Quality(self.quality.unwrap_or(Quality::MEDIUM)),
        };
        let (compressed, found) = goal.reach(data, out, measure)?;
        write_atomically(out, |file| file.write_all(&compressed.bytes))?;
        let names = [&scene.path, out].map(|path| path.display().to_string());
        let report = Report::new(names, data, &std::fs::read(&scene.path)?, &compressed, psnr(found))?;
        print_report(self.json.as_deref(), &report, &table(&report.rows(not_measured)))
    }
}
