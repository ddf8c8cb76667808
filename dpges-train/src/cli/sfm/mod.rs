//! `dpges sfm`: cameras for photographs that have none.

mod display;
pub mod options;

use std::ffi::OsString;
use std::path::{Path, PathBuf};

use clap::Args;
use dpges_train::config::key;
use dpges_train::dataset::capture::{self, Input, Options, Outcome, Programs, Request, SfmError, Unusable};
use dpges_train::dataset::{self, DatasetError};

use super::data::BUILTIN;
use super::{Failure, Result, print, table};
use crate::cli::logging::LogStyle;
use crate::cli::progress::Seconds;
use display::Display;
use options::SfmOptions;

/// Make a dataset of photographs or of a video: find their cameras, by COLMAP
///
/// `dpges train` does the same if it is given photographs or a video. COLMAP must be installed, and ffmpeg for a video. The
/// dataset has the layout of COLMAP. If this is interrupted or a program fails, the same command goes on. RAYON_NUM_THREADS
/// limits the threads of the programs.
#[derive(Debug, Args)]
pub struct SfmArgs {
    /// Folder of JPEGs and PNGs, or of a folder `images` or `input` with them; or a video
    photographs: PathBuf,
    /// Folder of the dataset [default: NAME_colmap, beside the photographs or the video]
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Replace the dataset in the folder if it was made of other photographs or with other options
    #[arg(long)]
    overwrite: bool,
    #[arg(long, help = key("data.invert_masks").help())]
    invert_masks: bool,
    #[command(flatten)]
    options: SfmOptions,
}

pub fn run(args: &SfmArgs, style: LogStyle) -> Result<()> {
    let path = absolute(&args.photographs);
    let input = Input::find(&path).ok_or_else(|| not_photographs(&path))?;
    let out = match &args.out {
        Some(out) => absolute(out),
        None => capture::dataset_beside(&input)?,
    };
    let outcome = reconstruct(&input, &out, &args.options.options(args.invert_masks), args.overwrite, style)?;
    if style == LogStyle::Quiet { Ok(()) } else { print(&summary(&outcome, args.invert_masks)) }
}

/// What a command was asked to train on: if that is photographs or a video, the dataset is made of it, unless it has been.
pub fn prepare(dataset: Option<&Path>, options: &Options, style: LogStyle) -> Result<()> {
    let Some(input) = dataset.and_then(input_of) else { return Ok(()) };
    let outcome = reconstruct(&input, &capture::dataset_beside(&input)?, options, false, style)?;
    let Outcome { dataset, photographs, points, .. } = &outcome;
    let placed = outcome.placed();
    tracing::info!("{}: {placed} of {photographs} photographs have a place, {points} points", dataset.display());
    Ok(())
}

/// The dataset that [`prepare`] makes of photographs or a video; `None` for anything else.
pub fn dataset_of(path: &Path) -> Option<PathBuf> {
    capture::dataset_beside(&input_of(path)?).ok()
}

/// What photographs or a video are called.
pub fn name_of(path: &Path) -> Option<OsString> {
    input_of(path)?.name().map(Into::into)
}

/// An error of reading the dataset at `path`, with advice if there are no cameras yet.
pub fn explained(error: DatasetError, path: &Path) -> Failure {
    if Input::find(path).is_some() {
        return Failure::with_help(error, format!("`dpges sfm {}` finds the cameras of photographs", path.display()));
    }
    if capture::is_begun(path) && dataset::format(path).is_none() {
        return Failure::with_help(error, "its cameras have not been found yet: repeat the command that began it");
    }
    match error {
        DatasetError::UnknownFormat { .. } => nothing_at(path),
        other => other.into(),
    }
}

fn nothing_at(path: &Path) -> Failure {
    let Unusable { message, advice } = capture::unusable(path);
    Failure::with_help(message, advice)
}

fn input_of(path: &Path) -> Option<Input> {
    (path != Path::new(BUILTIN)).then(|| Input::find(&absolute(path))).flatten()
}

fn absolute(path: &Path) -> PathBuf {
    std::path::absolute(path).unwrap_or_else(|_| path.to_owned())
}

fn reconstruct(input: &Input, dataset: &Path, options: &Options, overwrite: bool, style: LogStyle) -> Result<Outcome> {
    let programs = Programs::of_environment();
    let request = Request { input, dataset, options, overwrite, programs: &programs };
    let outcome = capture::reconstruct(&request, &mut Display::new(style)).map_err(|error| match error {
        SfmError::File(_) => {
            let help = format!("`dpges sfm {} --out DIR` puts the dataset elsewhere", input.path().display());
            Failure::with_help(error, help)
        }
        other => other.into(),
    })?;
    for warning in outcome.warnings() {
        tracing::warn!("{warning}");
    }
    Ok(outcome)
}

fn not_photographs(path: &Path) -> Failure {
    if dataset::format(path).is_none() {
        return nothing_at(path);
    }
    let path = path.display();
    Failure::with_help(format!("{path} is a dataset already"), format!("train on it: `dpges train {path}`"))
}

fn summary(outcome: &Outcome, invert_masks: bool) -> String {
    let placed = format!("{} of {} have a place", outcome.placed(), outcome.photographs);
    let total: f64 = outcome.seconds.iter().map(|(_, seconds)| seconds).sum();
    let parts = outcome.seconds.iter().map(|(step, seconds)| format!("{step} {}", Seconds(*seconds)));
    let (dataset, masked) = (outcome.dataset.display(), outcome.masked);
    let option = if invert_masks && masked > 0 { " --invert-masks" } else { "" };
    let mut rows = vec![("dataset", dataset.to_string()), ("photographs", placed)];
    if masked > 0 {
        rows.push(("masks", format!("{masked} of {}", outcome.photographs)));
    }
    rows.extend([
        ("points", outcome.points.to_string()),
        ("time", format!("{}: {}", Seconds(total), parts.collect::<Vec<_>>().join(", "))),
        ("next", format!("dpges train {dataset}{option}")),
    ]);
    table(&rows)
}
