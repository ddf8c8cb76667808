//! The subject that all rows of a trade share.

use std::path::Path;

use serde_json::{Map, Value, json};

use super::super::Result;
use super::super::store::checksum;
use super::bench::Bench;

/// The scene, the views and the device of a trade.
#[derive(Clone, Copy, Debug)]
pub struct Subject<'a> {
    /// The scene file.
    pub scene: &'a Path,
    /// As runs name it.
    pub dataset: &'a str,
    /// `test`, `train` or `validation`
    pub split: &'a str,
    /// Width and height of the frames whose time is measured, px.
    pub frame_size: [usize; 2],
    /// Name of the adapter, or of the device.
    pub device: &'a str,
}

impl Subject<'_> {
    /// As the JSON of the study has it, with the views of `bench`.
    ///
    /// # Errors
    /// If the scene cannot be read.
    pub fn of(&self, bench: &Bench) -> Result<Map<String, Value>> {
        let path = std::path::absolute(self.scene)?;
        let first = &bench.views[0].camera;
        let subject = json!({
            "scene": path.display().to_string(),
            "scene_checksum": checksum(&std::fs::read(&path)?),
            "dataset": self.dataset,
            "split": self.split,
            "views": bench.views.iter().map(|view| &view.name).collect::<Vec<_>>(),
            "view_size": [first.width, first.height],
            "frame_size": self.frame_size,
            "rounds": bench.rounds,
            "device": self.device,
        });
        Ok(subject.as_object().cloned().unwrap_or_default())
    }
}
