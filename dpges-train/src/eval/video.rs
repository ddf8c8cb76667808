//! Pictures as a video.

use std::io::{ErrorKind, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

use dpges_render::Rgb8Image;

/// Why there is no video, and what to do.
#[derive(Debug, thiserror::Error)]
pub enum VideoError {
    #[error(
        "--video: frames differ in size: {width}x{height} and {other_width}x{other_height} ({name}); give all the same with \
         --size"
    )]
    Sizes { width: usize, height: usize, other_width: usize, other_height: usize, name: String },
    #[error("--video: {} has no ending that says which format: use .mp4 or .webm", .file.display())]
    NoFormat { file: PathBuf },
    #[error("cannot write {}: {error}; choose another place", .path.display())]
    Write { path: PathBuf, error: std::io::Error },
    #[error(
        "--video needs the program {}, which is not installed; install ffmpeg (https://ffmpeg.org), name it with --ffmpeg, or \
         write PNGs with --out",
        .program.display()
    )]
    NoProgram { program: PathBuf },
    #[error("cannot start {}: {error}; name another with --ffmpeg", .program.display())]
    Start { program: PathBuf, error: std::io::Error },
    #[error(
        "{} could not make {}: {last}; choose another format by the ending of the file, or write PNGs with --out",
        .program.display(),
        .file.display()
    )]
    Failed { program: PathBuf, file: PathBuf, last: String },
}

impl VideoError {
    /// Whether it was asked for wrongly, and nothing failed.
    pub fn is_usage(&self) -> bool {
        matches!(self, Self::Sizes { .. } | Self::NoFormat { .. })
    }
}

/// A video that ffmpeg encodes. It takes the place of the file once it is complete.
pub struct Video {
    encoder: Child,
    program: PathBuf,
    file: PathBuf,
    unfinished: tempfile::TempPath,
}

impl Video {
    /// A file of `fps` pictures per second, by the `program` ffmpeg; `sizes` are the names and the sizes of the pictures, px.
    pub fn new<'a>(
        file: &Path,
        program: &Path,
        fps: u32,
        mut sizes: impl Iterator<Item = (&'a str, [usize; 2])>,
    ) -> Result<Self, VideoError> {
        let [width, height] = sizes.next().map_or([0; 2], |(_, size)| size);
        if let Some((name, [other_width, other_height])) = sizes.find(|(_, size)| *size != [width, height]) {
            return Err(VideoError::Sizes { width, height, other_width, other_height, name: name.to_owned() });
        }
        let Some(extension) = file.extension().and_then(|extension| extension.to_str()) else {
            return Err(VideoError::NoFormat { file: file.to_owned() });
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
            .map_err(|error| VideoError::Write { path: folder.to_owned(), error })?
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
            ErrorKind::NotFound => VideoError::NoProgram { program: program.to_owned() },
            _ => VideoError::Start { program: program.to_owned(), error },
        })?;
        Ok(Self { encoder, program: program.to_owned(), file: file.to_owned(), unfinished })
    }

    /// # Errors
    /// [`VideoError::Failed`].
    pub fn take(&mut self, picture: &Rgb8Image) -> Result<(), VideoError> {
        let written = self.encoder.stdin.as_mut().map(|input| input.write_all(&picture.bytes));
        match written {
            Some(Ok(())) => Ok(()),
            // it has ended early: what it says about that is the message
            _ => Err(self.failure()),
        }
    }

    /// Completes the file; returns its path.
    ///
    /// # Errors
    /// [`VideoError::Failed`], [`VideoError::Write`].
    pub fn finish(mut self) -> Result<PathBuf, VideoError> {
        drop(self.encoder.stdin.take());
        if !self.encoder.wait().is_ok_and(|status| status.success()) {
            return Err(self.failure());
        }
        let failed =
            |error: tempfile::PathPersistError| VideoError::Write { path: self.file.clone(), error: error.error };
        self.unfinished.persist(&self.file).map_err(failed)?;
        Ok(self.file)
    }

    fn failure(&mut self) -> VideoError {
        drop(self.encoder.stdin.take());
        let mut said = String::new();
        if let Some(mut errors) = self.encoder.stderr.take() {
            // what it says is wanted, not needed
            let _ = std::io::Read::read_to_string(&mut errors, &mut said);
        }
        let last = said.trim().lines().last().unwrap_or("it says nothing").to_owned();
        VideoError::Failed { program: self.program.clone(), file: self.file.clone(), last }
    }
}
