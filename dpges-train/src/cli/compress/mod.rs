//! `dpges compress`: a scene in fewer bytes.

mod report;
mod target;

use std::io::Write;
use std::path::{Path, PathBuf};

use burn::tensor::Device;
use clap::Args;
use dpges_core::scene::SceneData;
use dpges_core::scene::atomic::write_atomically;
use dpges_train::config::budget::MEGABYTE;
use dpges_train::dataset::View;
use dpges_train::device::DeviceRequest;
use dpges_train::eval::compress::{CompressError, Compressed, within_loss, within_size};
use dpges_train::eval::evaluate;
use dpges_train::run::folder::write_json;

use self::report::{Psnr, Report};
use self::target::{Level, Target};
use super::data::{Scene, Source, Split, ViewArgs, every_nth};
use super::device_failure::watched;
use super::export::reason;
use super::{Failure, Result, device_choice, print, table};

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
    /// Scene file or folder of a run
    scene: PathBuf,
    /// File to write
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    /// How exact numbers are [default: medium]
    #[arg(long, value_enum, value_name = "LEVEL", conflicts_with = "target")]
    quality: Option<Level>,
    /// Instead of a quality: the largest size of the file, as in 10MB, for which the best quality is found; or the largest
    /// loss of PSNR, as in 0.1dB, for which the smallest file is found (this renders up to 32 views a few dozen times)
    #[arg(long, value_name = "SIZE|LOSS")]
    target: Option<Target>,
    #[command(flatten)]
    views: ViewArgs,
    /// auto (a GPU that passes a check, or else the CPU), cpu, cpu-flex, wgpu (the best GPU), or another one that
    /// `dpges devices` lists
    #[arg(long, value_name = "NAME", default_value_t)]
    device: DeviceRequest,
    /// Write the result to this file; `-` is standard output
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
}

pub fn run(args: &CompressArgs) -> Result<()> {
    let mut scene = Scene::load(&args.scene)?;
    if is_same_file(&args.out, &scene.path) {
        let message = format!("--out is the scene itself, {}: name another file", scene.path.display());
        return Err(Failure::Usage(message));
    }
    match args.measured(&mut scene) {
        Ok((source, split, views)) => {
            let device = device_choice::select(args.device)?;
            watched(device, || {
                let measuring = Measuring { source: &source, split, views: &views, device: device.open()? };
                args.compress(&scene, Ok(&measuring))
            })
        }
        Err(failure) if args.views.names_dataset() => Err(failure),
        Err(failure) => args.compress(&scene, Err(failure)),
    }
}

/// What pictures are compared with.
struct Measuring<'a> {
    source: &'a Source,
    split: Split,
    views: &'a [View],
    device: Device,
}

impl Measuring<'_> {
    /// dB, mean over the views.
    fn psnr(&self, scene: &SceneData) -> dpges_core::Result<f64> {
        Ok(evaluate(scene, self.views, &self.device)?.psnr)
    }

    /// [`psnr`](Self::psnr) of a compressed scene, with a line about it.
    fn psnr_of(&self, compressed: &Compressed) -> dpges_core::Result<f64> {
        let psnr = self.psnr(&compressed.scene()?)?;
        tracing::info!(
            "{:.3} MB: {psnr:.3} dB, {:?}",
            compressed.bytes.len() as f64 / MEGABYTE,
            compressed.quality.list()
        );
        Ok(psnr)
    }
}

impl CompressArgs {
    /// The views that are measured, of which split they are, and what they were read from.
    fn measured(&self, scene: &mut Scene) -> Result<(Source, Split, Vec<View>)> {
        if !matches!(self.target, Some(Target::Loss(_))) {
            let (source, views) = self.views.load(scene)?;
            return Ok((source, self.views.split(), views));
        }
        let (source, dataset, split) = self.views.load_to_decide(scene)?;
        Ok((source, split, every_nth(split.of(&dataset), DECIDING_VIEWS).cloned().collect()))
    }

    /// Compresses the scene; `measuring` may be impossible.
    fn compress(&self, scene: &Scene, measuring: Result<&Measuring>) -> Result<()> {
        let (data, out) = (&scene.data, &self.out);
        let (measuring, not_measured) = match measuring {
            Ok(measuring) => (Some(measuring), String::new()),
            Err(failure) => (None, reason(&failure)),
        };
        let before = measuring.map(|measuring| measuring.psnr(data)).transpose()?;
        let (compressed, after) = match self.target {
            None => (Compressed::new(data, &self.quality.unwrap_or(Level::Medium).quality(), out)?, None),
            Some(Target::Bytes(largest)) => (within_size(data, largest, out).map_err(failure)?, None),
            Some(target @ Target::Loss(allowed)) => {
                let Some((measuring, before)) = measuring.zip(before) else {
                    let message = format!("--target {target} compares with photographs: {not_measured}");
                    return Err(Failure::Usage(message));
                };
                let found = within_loss(data, before, allowed, out, |candidate| measuring.psnr_of(candidate));
                let (compressed, after) = found.map_err(failure)?;
                (compressed, Some(after))
            }
        };
        let psnr = match measuring.zip(before) {
            Some((measuring, psnr_before)) => Some(Psnr {
                dataset: measuring.source.to_string(),
                split: measuring.split.to_string(),
                views: measuring.views.len(),
                psnr_before,
                psnr_after: after.map_or_else(|| compressed.scene().and_then(|scene| measuring.psnr(&scene)), Ok)?,
            }),
            None => None,
        };
        write_atomically(out, |file| file.write_all(&compressed.bytes))?;
        let names = [&scene.path, out].map(|path| path.display().to_string());
        let report = Report::new(names, data, &std::fs::read(&scene.path)?, &compressed, psnr)?;
        let rows = table(&report.rows(&not_measured));
        match self.json.as_deref() {
            Some(path) if path == Path::new("-") => {
                // The table is for people: if nobody can read it, the result is still on standard output.
                let _ = std::io::stderr().write_all(rows.as_bytes());
                print(&format!("{}\n", serde_json::to_string_pretty(&report)?))
            }
            Some(path) => {
                write_json(path, &report)?;
                print(&rows)
            }
            None => print(&rows),
        }
    }
}

/// With advice.
fn failure(error: CompressError) -> Failure {
    let help = match &error {
        CompressError::TooLarge { smallest, .. } => {
            let kilobytes = (*smallest as f64 / 1e3).ceil();
            format!("allow `--target {}MB`, or train a scene of fewer primitives (`--budget`)", kilobytes / 1e3)
        }
        CompressError::TooDifferent { .. } => "allow a larger loss, or keep the scene as it is".to_owned(),
        CompressError::Scene(_) => return error.into(),
    };
    Failure::with_help(error, help)
}

/// Whether both paths lead to one file that is there.
fn is_same_file(a: &Path, b: &Path) -> bool {
    let [a, b] = [a, b].map(|path| path.canonicalize().ok());
    a.is_some() && a == b
}
