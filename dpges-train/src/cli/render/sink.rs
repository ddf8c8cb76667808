//! Where pictures go: PNGs, a video, or both.

use std::io::{ErrorKind, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

use dpges_render::Rgb8Image;
use dpges_train::eval::pictures::save_png;
use dpges_train::eval::rendered::LayerPictures;
use dpges_train::run::folder::write_json;
use indicatif::ProgressStyle;
use serde_json::{Value, json};
use tracing::Span;
use tracing_indicatif::span_ext::IndicatifSpanExt;

use super::super::eval::make_folder;
use super::super::{Failure, Result};
use super::RenderArgs;
use super::cameras::Shot;
use super::painter::Painted;

/// Takes the pictures of one command, and shows how far it is.
pub struct Sink {
    folder: Option<PathBuf>,
    video: Option<Video>,
    ranges: Vec<Value>,
    layers: bool,
    count: usize,
    progress: Span,
}

impl Sink {
    pub fn new(args: &RenderArgs, shots: &[Shot]) -> Result<Self> {
        if let Some(folder) = &args.out {
            make_folder(folder)?;
        }
        let video = args.video.as_deref().map(|file| Video::new(file, &args.ffmpeg, args.fps, shots)).transpose()?;
        let progress = tracing::info_span!("rendering");
        progress.pb_set_style(&ProgressStyle::with_template("{wide_bar} {pos}/{len}").expect("a valid template"));
        progress.pb_set_length(shots.len() as u64);
        progress.pb_start();
        Ok(Self { folder: args.out.clone(), video, ranges: Vec::new(), layers: args.layers, count: 0, progress })
    }

    pub fn take(&mut self, shot: &Shot, painted: &Painted) -> Result<()> {
        if let Some(folder) = &self.folder {
            save_png(&painted.picture, &folder.join(format!("{}.png", shot.stem)))?;
            if let Some(layers) = &painted.layers {
                self.ranges.push(save_layers(folder, shot, layers)?);
            }
        }
        if let Some(video) = &mut self.video {
            video.take(&painted.picture)?;
        }
        self.count += 1;
        self.progress.pb_inc(1);
        Ok(())
    }

    /// Completes the files; returns what was written.
    pub fn finish(self) -> Result<String> {
        let mut said = String::new();
        if let Some(folder) = &self.folder {
            if self.layers {
                write_json(&folder.join("layers.json"), &self.ranges)?;
            }
            said += &format!("{} views in {}\n", self.count, folder.display());
        }
        if let Some(video) = self.video {
            let file = video.finish()?;
            said += &format!("{} frames in {}\n", self.count, file.display());
        }
        Ok(said)
    }
}

/// Returns the view's entry in `layers.json`.
fn save_layers(folder: &Path, shot: &Shot, pictures: &LayerPictures) -> Result<Value> {
    let mut named = vec![
        ("surfels".to_owned(), &pictures.surfels),
        ("depth".to_owned(), &pictures.depth),
        ("normal".to_owned(), &pictures.normal),
    ];
    let behind = pictures.transmittance.iter().zip(1..);
    named.extend(behind.map(|(picture, layer)| (format!("transmittance_{layer}"), picture)));
    for (name, picture) in named {
        save_png(picture, &folder.join(format!("{}_{name}.png", shot.stem)))?;
    }
    let [near, far] = pictures.depth_range.map_or([None; 2], |range| range.map(Some));
    Ok(json!({ "name": shot.name, "file": shot.stem, "depth_near": near, "depth_far": far }))
}

/// A video that ffmpeg encodes. It takes the place of the file once it is complete.
struct Video {
    encoder: Child,
    program: PathBuf,
    file: PathBuf,
    unfinished: tempfile::TempPath,
}

impl Video {
    fn new(file: &Path, program: &Path, fps: u32, shots: &[Shot]) -> Result<Self> {
        let first = &shots[0].camera;
        let (width, height) = (first.width, first.height);
        if let Some(other) = shots.iter().find(|shot| (shot.camera.width, shot.camera.height) != (width, height)) {
            let message = format!(
                "--video: frames differ in size: {width}x{height} and {}x{} ({}); give all the same with --size",
                other.camera.width, other.camera.height, other.name
            );
            return Err(Failure::Usage(message));
        }
        let Some(extension) = file.extension().and_then(|extension| extension.to_str()) else {
            let message =
                format!("--video: {} has no ending that says which format: use .mp4 or .webm", file.display());
            return Err(Failure::Usage(message));
        };
        let folder = file.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."));
        let (prefix, suffix) = (".dpges-", format!(".{extension}"));
        let mut builder = tempfile::Builder::new();
        #[cfg(unix)]
        builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666));
        let unfinished = builder
            .prefix(prefix)
            .suffix(&suffix)
            .tempfile_in(folder)
            .map_err(|error| {
                Failure::with_help(format!("cannot write into {}: {error}", folder.display()), "choose another folder")
            })?
            .into_temp_path();
        let encoder = Command::new(program)
            .args(["-y", "-loglevel", "error", "-f", "rawvideo", "-pix_fmt", "rgb24"])
            .args(["-s", &format!("{width}x{height}"), "-r", &fps.to_string(), "-i", "-"])
            // most players need sides that are even, and colours at half the resolution
            .args(["-vf", "pad=ceil(iw/2)*2:ceil(ih/2)*2", "-pix_fmt", "yuv420p"])
            .arg(&unfinished)
            .stdin(Stdio::piped())
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn();
        let encoder = encoder.map_err(|error| match error.kind() {
            ErrorKind::NotFound => Failure::with_help(
                format!("--video needs the program {}, which is not installed", program.display()),
                "install ffmpeg (https://ffmpeg.org), name it with --ffmpeg, or write PNGs with --out",
            ),
            _ => {
                Failure::with_help(format!("cannot start {}: {error}", program.display()), "name another with --ffmpeg")
            }
        })?;
        Ok(Self { encoder, program: program.to_owned(), file: file.to_owned(), unfinished })
    }

    fn take(&mut self, picture: &Rgb8Image) -> Result<()> {
        let written = self.encoder.stdin.as_mut().map(|input| input.write_all(&picture.bytes));
        match written {
            Some(Ok(())) => Ok(()),
            // it has ended early: what it says about that is the message
            _ => Err(self.failure()),
        }
    }

    fn finish(mut self) -> Result<PathBuf> {
        drop(self.encoder.stdin.take());
        if !self.encoder.wait()?.success() {
            return Err(self.failure());
        }
        let failed = |error: tempfile::PathPersistError| {
            Failure::with_help(format!("cannot write {}: {error}", self.file.display()), "choose another file")
        };
        self.unfinished.persist(&self.file).map_err(failed)?;
        Ok(self.file)
    }

    fn failure(&mut self) -> Failure {
        drop(self.encoder.stdin.take());
        let mut said = String::new();
        if let Some(mut errors) = self.encoder.stderr.take() {
            // what it says is wanted, not needed
            let _ = std::io::Read::read_to_string(&mut errors, &mut said);
        }
        let last = said.trim().lines().last().unwrap_or("it says nothing").to_owned();
        let message = format!("{} could not make {}: {last}", self.program.display(), self.file.display());
        Failure::with_help(message, "choose another format by the ending of the file, or write PNGs with --out")
    }
}
