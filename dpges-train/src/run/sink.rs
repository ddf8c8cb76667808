//! Where pictures go: PNGs, a video, or both.

use serde_json::{Value, json};

use super::folder::write_json;
use super::hold::{Hold, HoldError};
use super::shots::Shot;
use crate::eval::painted::{Painted, Wanted};
use crate::eval::pictures::{save_depth, save_png_with};
use crate::eval::video::{Video, VideoError};

/// Depth ranges of the pictures of layers.
const RANGES: &str = "layers.json";

/// Why pictures cannot be written.
#[derive(Debug, thiserror::Error)]
pub enum SinkError {
    #[error(transparent)]
    Hold(#[from] HoldError),
    #[error(transparent)]
    Video(#[from] VideoError),
    #[error(transparent)]
    Core(#[from] dpges_core::Error),
}

/// Takes the pictures of one command.
pub struct Sink {
    hold: Option<Hold>,
    video: Option<Video>,
    /// Entries of `layers.json`.
    ranges: Vec<Value>,
    /// Names of the files so far.
    written: Vec<String>,
    count: usize,
}

impl Sink {
    /// Writes pictures of `shots`, with what is `wanted` of them, to the folder of `hold`, and to `video`.
    ///
    /// # Errors
    /// [`SinkError::Hold`].
    pub fn new(hold: Option<Hold>, video: Option<Video>, shots: &[Shot], wanted: Wanted) -> Result<Self, SinkError> {
        let kinds = if wanted.depth { &[".png", "_depth.exr"][..] } else { &[".png"] };
        let coming = shots.iter().flat_map(|shot| kinds.iter().map(move |kind| format!("{}{kind}", shot.stem)));
        hold.as_ref().map(|hold| hold.add_files(coming)).transpose()?;
        Ok(Self { hold, video, ranges: Vec::new(), written: Vec::new(), count: 0 })
    }

    /// Takes the next picture; returns how many there are.
    ///
    /// # Errors
    /// [`SinkError`].
    pub fn take(&mut self, shot: &Shot, painted: &Painted) -> Result<usize, SinkError> {
        let Painted { picture, alpha, depth, layers } = painted;
        if let Some(folder) = self.hold.as_ref().map(Hold::folder) {
            let stem = &shot.stem;
            self.written.push(format!("{stem}.png"));
            save_png_with(picture, alpha.as_deref(), &folder.join(format!("{stem}.png")))?;
            if let Some(depth) = depth {
                self.written.push(format!("{stem}_depth.exr"));
                save_depth(depth, [picture.width, picture.height], &folder.join(format!("{stem}_depth.exr")))?;
            }
            if let Some(layers) = layers {
                self.written.extend(layers.save(folder, stem)?);
                let [near, far] = layers.depth_range.map_or([None; 2], |range| range.map(Some));
                self.ranges.push(json!({ "name": shot.name, "file": stem, "depth_near": near, "depth_far": far }));
            }
        }
        if let Some(video) = &mut self.video {
            video.take(picture)?;
        }
        self.count += 1;
        Ok(self.count)
    }

    /// Completes the files, and removes those of an earlier, longer path; returns what was written.
    ///
    /// # Errors
    /// [`SinkError`].
    pub fn finish(mut self) -> Result<String, SinkError> {
        let mut said = String::new();
        if let Some(hold) = &self.hold {
            if !self.ranges.is_empty() {
                write_json(&hold.folder().join(RANGES), &self.ranges)?;
                self.written.push(RANGES.to_owned());
            }
            hold.replace_files(&self.written)?;
            said += &format!("{} views in {}\n", self.count, hold.folder().display());
        }
        if let Some(video) = self.video {
            let file = video.finish()?;
            said += &format!("{} frames in {}\n", self.count, file.display());
        }
        Ok(said)
    }
}
