//! What is expected of a run that has a target, kept in its folder until it ends.

use dpges_core::camera::Camera;
use serde::{Deserialize, Serialize};

/// How a target is reached.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Plan {
    /// `bytes`, `seconds` or `frames_per_second`.
    pub unit: String,
    pub expected: f64,
    /// In words.
    pub how: String,
    /// Where frames are measured from, in the coordinates of the scene; empty for other targets.
    pub cameras: Vec<Camera>,
}

impl Plan {
    /// A value in the unit, for people.
    pub fn written(&self, value: f64) -> String {
        match self.unit.as_str() {
            "bytes" => format!("{:.2} MB", value / 1e6),
            "seconds" => format!("{value:.1} s"),
            _ => format!("{value:.1} fps"),
        }
    }
}
