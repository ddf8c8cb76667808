//! Frames of a video as photographs: ffmpeg takes three times as many as asked for, evenly, and the sharpest of each three
//! stays.

use std::path::{Path, PathBuf};
use std::process::Command;

use image::ImageReader;
use rayon::prelude::*;

use super::FEWEST;
use super::commands::number;
use super::error::{SfmError, io};
use super::programs::{run, said};
use super::step::{Observer, Step};
use super::workspace::{Workspace, file_names, remove, replace};
use crate::check::luma::Luma;

/// How many frames are compared for each that stays.
const CANDIDATES: usize = 3;
/// Frames per second of a video that does not say how long it is.
const DEFAULT_RATE: f64 = 2.0;
/// Longer side at which frames are compared, px.
const COMPARED_SIZE: usize = 1000;

/// Makes `images` of at most `count` frames of the video at `path`.
pub(super) fn extract(
    ffmpeg: &Path,
    path: &Path,
    count: usize,
    workspace: &Workspace,
    observer: &mut dyn Observer,
) -> Result<(), SfmError> {
    let about = said(Command::new(ffmpeg).args(["-hide_banner", "-nostdin", "-i"]).arg(path))?;
    let seconds = duration(&about);
    let rate = rate(CANDIDATES * count, seconds, frames_per_second(&about));
    let expected = seconds.map(|seconds| ((seconds * rate).round() as usize).max(1));
    let candidates = workspace.empty_folder("frames.part")?;
    let log = workspace.log(Step::Pictures);
    let mut command = Command::new(ffmpeg);
    command.args(["-hide_banner", "-nostdin", "-nostats", "-y", "-i"]).arg(path);
    command.args(["-an", "-sn", "-vf", &format!("fps={rate:.6}"), "-q:v", "2", "-progress", "pipe:1"]);
    command.arg(candidates.join("frame_%06d.jpg"));
    run(Step::Pictures, command, &log, &mut |line| {
        let done = line.strip_prefix("frame=").and_then(|done| number(done.trim_start()));
        if let (Some(done), Some(expected)) = (done, expected) {
            observer.progress(Step::Pictures, done.min(expected), expected);
        }
    })?;
    let found: Vec<PathBuf> = file_names(&candidates)?.into_iter().map(|name| candidates.join(name)).collect();
    if found.len() < FEWEST {
        return Err(SfmError::TooFewFrames { path: path.to_owned(), found: found.len(), log });
    }
    let part = workspace.empty_folder("images.part")?;
    for (number, frame) in sharpest(&found, count)?.iter().enumerate() {
        let place = part.join(format!("frame_{:05}.jpg", number + 1));
        std::fs::rename(frame, &place).map_err(io("cannot write", &place))?;
    }
    replace(&part, &workspace.images)?;
    remove(&candidates)
}

/// Frames per second that give `count` frames, but no more than the video has.
fn rate(count: usize, seconds: Option<f64>, most: Option<f64>) -> f64 {
    let rate = seconds.map_or(DEFAULT_RATE, |seconds| count as f64 / seconds);
    most.map_or(rate, |most| rate.min(most))
}

/// Length in s, by what ffmpeg says: `Duration: 00:01:02.50, …`.
fn duration(about: &str) -> Option<f64> {
    let (_, rest) = about.split_once("Duration: ")?;
    let parts: Vec<f64> =
        rest.split(',').next()?.split(':').map(|part| part.trim().parse().ok()).collect::<Option<_>>()?;
    let &[hours, minutes, seconds] = parts.as_slice() else { return None };
    let length = 3600.0 * hours + 60.0 * minutes + seconds;
    (length > 0.0).then_some(length)
}

/// By what ffmpeg says of the first stream with pictures: `…, 29.97 fps, …`.
fn frames_per_second(about: &str) -> Option<f64> {
    let (before, _) = about.split_once(" fps")?;
    before.rsplit([',', ' ']).next()?.parse().ok().filter(|&rate: &f64| rate > 0.0)
}

/// The sharpest of each group of neighbours; `found` is divided into at most `count` groups of equal size.
fn sharpest(found: &[PathBuf], count: usize) -> Result<Vec<PathBuf>, SfmError> {
    if found.len() <= count {
        return Ok(found.to_vec());
    }
    let sharpness: Vec<f64> = found.par_iter().map(|path| sharpness(path)).collect::<Result<_, _>>()?;
    let group = |index: usize| index * found.len() / count..(index + 1) * found.len() / count;
    let best = |index: usize| group(index).max_by(|&a, &b| sharpness[a].total_cmp(&sharpness[b]));
    Ok((0..count).filter_map(best).map(|index| found[index].clone()).collect())
}

fn sharpness(path: &Path) -> Result<f64, SfmError> {
    let decoded = ImageReader::open(path).map_err(io("cannot read", path))?.decode();
    let picture = decoded.map_err(|source| SfmError::Image { path: path.to_owned(), source })?.into_luma8();
    let (width, height) = (picture.width() as usize, picture.height() as usize);
    let values = picture.into_raw().into_iter().map(|value| f32::from(value) / 255.0).collect();
    Ok(Luma { width, height, values }.at_most(COMPARED_SIZE).detail().iter().sum())
}

#[cfg(test)]
mod tests {
    use super::*;

    const ABOUT: &str = "Input #0, mov,mp4,m4a,3gp,3g2,mj2, from 'walk.mp4':\n  Metadata:\n    major_brand     : isom\n  \
                         Duration: 00:01:40.50, start: 0.000000, bitrate: 9000 kb/s\n  Stream #0:0(und): Video: h264 \
                         (High) (avc1), yuv420p, 1920x1080, 8990 kb/s, 29.97 fps, 30 tbr, 90k tbn\nAt least one output \
                         file must be specified\n";

    #[test]
    fn length_and_rate_are_read() {
        assert_eq!((duration(ABOUT), frames_per_second(ABOUT)), (Some(100.5), Some(29.97)));
        for text in ["", "Duration: N/A, start", "Duration: 00:00:00.00,", "no fps"] {
            assert_eq!((duration(text), frames_per_second(text)), (None, None), "{text}");
        }
    }

    #[test]
    fn the_rate_gives_the_frames_that_are_asked_for_and_no_frame_twice() {
        assert_eq!(rate(300, Some(100.0), Some(30.0)), 3.0);
        assert_eq!(rate(300, Some(5.0), Some(30.0)), 30.0);
        assert_eq!(rate(300, Some(5.0), None), 60.0);
        assert_eq!(rate(300, None, Some(1.0)), 1.0);
        assert_eq!(rate(300, None, None), DEFAULT_RATE);
    }

    #[test]
    fn the_sharpest_of_neighbours_is_taken() {
        let folder = tempfile::tempdir().unwrap();
        let frame = |index: usize, contrast: u8| {
            let path = folder.path().join(format!("{index}.png"));
            let grey = |x: u32| image::Luma([if x % 8 < 4 { 100 } else { 100 + contrast }]);
            image::GrayImage::from_fn(32, 32, |x, _| grey(x)).save(&path).unwrap();
            path
        };
        let found: Vec<PathBuf> = [10, 80, 5, 0, 1, 7, 9].into_iter().enumerate().map(|(i, c)| frame(i, c)).collect();
        let taken = |count: usize| sharpest(&found, count).unwrap();
        assert_eq!(taken(2), [found[1].clone(), found[6].clone()]);
        assert_eq!(taken(7), found);
        assert_eq!(taken(3), [1, 2, 6].map(|index| found[index].clone()));
    }
}
