//! `dpges sfm`: cameras for photographs that have none.

use std::path::{Path, PathBuf};

use clap::Args;
use dpges_train::config::duration::Seconds;
use dpges_train::config::key;
use dpges_train::dataset;
use dpges_train::dataset::capture::{
    self, FEWEST, Input, Observer, Options, Outcome, Programs, Request, SfmCamera, SfmError, SfmMatching, SfmProgram,
    Step,
};
use dpges_train::dataset::source::photographs;

use super::progress::Progress;
use super::{Failure, Result, table};
use crate::logging::LogStyle;

/// Make a dataset of photographs or of a video: find their cameras, by COLMAP
///
/// `dpges train` does the same if it is given photographs or a video. COLMAP must be installed, and ffmpeg for a video. The
/// dataset has the layout of COLMAP. If this is interrupted or a program fails, the same command goes on; a dataset that is
/// finished stays as it is. RAYON_NUM_THREADS limits the threads of the programs.
#[derive(Debug, Args)]
pub struct SfmArgs {
    /// Folder of JPEGs, PNGs and WebPs, or of a folder `images` or `input` with them; or a video
    photographs: PathBuf,
    /// Folder of the dataset [default: NAME_colmap, beside the photographs or the video]
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Make a dataset anew that is in the folder already
    #[arg(long)]
    overwrite: bool,
    #[arg(long, help = key("data.invert_masks").help())]
    invert_masks: bool,
    #[command(flatten)]
    options: SfmOptions,
}

/// Options on photographs without cameras.
#[derive(Debug, Args)]
pub struct SfmOptions {
    /// Which program places the cameras of photographs without cameras
    #[arg(long, value_name = "PROGRAM", value_enum, default_value_t)]
    sfm: SfmProgram,
    /// Which camera model it fits to them
    #[arg(long, value_name = "MODEL", value_enum, default_value_t)]
    sfm_camera: SfmCamera,
    /// Which pairs of them it compares
    #[arg(long, value_name = "PAIRS", value_enum, default_value_t)]
    sfm_matching: SfmMatching,
    /// Largest number of frames of a video that become photographs. Of neighbouring frames the sharpest is taken
    #[arg(long, value_name = "N", value_parser = frames, default_value_t = Options::default().video_frames)]
    video_frames: usize,
}

impl SfmOptions {
    /// For photographs whose masks are black where they count if `invert_masks`.
    pub fn options(&self, invert_masks: bool) -> Options {
        Options {
            program: self.sfm,
            camera: self.sfm_camera,
            matching: self.sfm_matching,
            video_frames: self.video_frames,
            invert_masks,
            ..Options::default()
        }
    }
}

fn frames(text: &str) -> Result<usize, String> {
    let fewest = || format!("expected a number of frames, at least {FEWEST}");
    text.parse().ok().filter(|&frames| frames >= FEWEST).ok_or_else(fewest)
}

pub fn run(args: &SfmArgs, style: LogStyle) -> Result<()> {
    let input = photographs(&args.photographs, true).ok_or_else(|| not_photographs(&args.photographs))?;
    let out = match &args.out {
        Some(out) => std::path::absolute(out)?,
        None => capture::dataset_beside(&input)?,
    };
    let outcome = reconstruct(&input, &out, &args.options.options(args.invert_masks), args.overwrite, style)?;
    style.print(&summary(&outcome, args.invert_masks))
}

/// Makes a dataset of the photographs or the video that a command was given, unless there is one; other datasets stay as they
/// are.
pub fn prepare(dataset: Option<&Path>, options: &Options, style: LogStyle) -> Result<()> {
    let Some(input) = dataset.and_then(|path| photographs(path, false)) else { return Ok(()) };
    let outcome = reconstruct(&input, &capture::dataset_beside(&input)?, options, false, style)?;
    let Outcome { dataset, photographs, points, .. } = &outcome;
    let placed = outcome.placed();
    let made = if outcome.seconds.is_empty() { " (made before)" } else { "" };
    tracing::info!("{}{made}: {placed} of {photographs} photographs have a place, {points} points", dataset.display());
    Ok(())
}

fn not_photographs(path: &Path) -> Failure {
    if dataset::format(path).is_none() {
        return capture::unusable(path).into();
    }
    let path = path.display();
    Failure::with_help(format!("{path} is a dataset already"), format!("train on it: `dpges train {path}`"))
}

fn reconstruct(input: &Input, dataset: &Path, options: &Options, overwrite: bool, style: LogStyle) -> Result<Outcome> {
    let programs = Programs::of_environment();
    let request = Request { input, dataset, options, overwrite, programs: &programs };
    let mut display = Display { style, progress: None };
    let outcome = capture::reconstruct(&request, &mut display).map_err(|error| match error {
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
        if outcome.seconds.is_empty() {
            ("made", "before; --overwrite makes it anew".to_owned())
        } else {
            ("time", format!("{}: {}", Seconds(total), parts.collect::<Vec<_>>().join(", ")))
        },
        ("next", format!("dpges train {dataset}{option}")),
    ]);
    table(&rows)
}

/// Messages and progress on standard error.
struct Display {
    style: LogStyle,
    /// Of the step that goes on.
    progress: Option<Progress>,
}

impl Observer for Display {
    fn begin(&mut self, step: Step) {
        let text = match step {
            Step::Pictures => "taking the pictures",
            Step::Features => "looking for features",
            Step::Matches => "comparing pairs of photographs",
            Step::Mapping => "placing the cameras",
        };
        let progress = Progress::new(self.style, 0, 1);
        if self.style == LogStyle::Bar {
            progress.message(&format!("{step}: {text}"));
        } else {
            tracing::info!("{step}: {text}");
        }
        self.progress = Some(progress);
    }

    fn progress(&mut self, step: Step, done: usize, total: usize) {
        match self.progress.as_mut().and_then(|progress| progress.step(done, total)) {
            Some(LogStyle::Json) => tracing::info!(step = step.name(), done, total),
            Some(LogStyle::Lines) => tracing::info!("{step}: {done} of {total}"),
            _ => {}
        }
    }

    fn end(&mut self, step: Step, seconds: f64) {
        self.progress = None;
        tracing::info!("{step}: done in {}", Seconds(seconds));
    }

    fn warn(&mut self, message: &str) {
        tracing::warn!("{message}");
    }
}
