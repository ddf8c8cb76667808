//! Where pictures go: PNGs, a video, or both.

use std::path::PathBuf;

use dpges_core::scene::atomic::make_folder;
use dpges_train::eval::pictures::save_png;
use dpges_train::eval::shots::Shot;
use dpges_train::eval::video::Video;
use dpges_train::run::folder::write_json;
use serde_json::{Value, json};

use super::super::Result;
use super::super::logging::LogStyle;
use super::super::progress::Progress;
use super::{Painted, RenderArgs};

/// Takes the pictures of one command, and shows how far it is.
pub struct Sink {
    folder: Option<PathBuf>,
    video: Option<Video>,
    /// Entries of `layers.json`.
    ranges: Vec<Value>,
    layers: bool,
    count: usize,
    progress: Progress,
    total: usize,
}

impl Sink {
    pub fn new(args: &RenderArgs, shots: &[Shot]) -> Result<Self> {
        if let Some(folder) = &args.out {
            make_folder(folder)?;
        }
        let sizes = shots.iter().map(|shot| (shot.name.as_str(), [shot.camera.width, shot.camera.height]));
        let video = args.video.as_deref().map(|file| Video::new(file, &args.ffmpeg, args.fps, sizes)).transpose()?;
        let (out, total) = (args.out.clone(), shots.len());
        let progress = Progress::new(LogStyle::Bar, 0, total);
        Ok(Self { folder: out, video, ranges: Vec::new(), layers: args.layers, count: 0, progress, total })
    }

    pub fn take(&mut self, shot: &Shot, (picture, layers): &Painted) -> Result<()> {
        if let Some(folder) = &self.folder {
            save_png(picture, &folder.join(format!("{}.png", shot.stem)))?;
            if let Some(layers) = layers {
                layers.save(folder, &shot.stem)?;
                let [near, far] = layers.depth_range.map_or([None; 2], |range| range.map(Some));
                self.ranges.push(json!({ "name": shot.name, "file": shot.stem, "depth_near": near, "depth_far": far }));
            }
        }
        if let Some(video) = &mut self.video {
            video.take(picture)?;
        }
        self.count += 1;
        self.progress.step(self.count, self.total);
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
