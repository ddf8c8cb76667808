//! The frame of a path that pops most, and the picture of it.

use std::fmt;
use std::path::{Path, PathBuf};

use dpges_core::Result;
use dpges_render::{Rgb8Image, false_colour};

use super::{Frame, Warped};
use crate::eval::pictures::save_png;

const NOT_COMPARED: [u8; 3] = [128; 3];

/// The frame of a path that differs most from an earlier one, as it would look from its camera.
#[derive(Clone, Debug, PartialEq)]
pub struct WorstFrame {
    /// Mean FLIP of the pixels that are compared, from 0 to 1.
    pub flip: f64,
    /// Of the frame on the path, from 0.
    pub number: usize,
    /// Frames since the earlier one.
    pub step: usize,
    /// The earlier frame as it would look from the later camera · the later frame · their FLIP, dark blue where there is
    /// none, yellow where it is 1, grey where nothing is compared; from left to right.
    pub picture: Rgb8Image,
}

impl WorstFrame {
    /// Writes the picture as `worst_flip_STEP.png` into `folder`; returns its path.
    pub fn save(&self, folder: &Path) -> Result<PathBuf> {
        let path = folder.join(format!("worst_flip_{}.png", self.step));
        save_png(&self.picture, &path)?;
        Ok(path)
    }
}

impl fmt::Display for WorstFrame {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { flip, number, step, .. } = self;
        write!(f, "FLIP_{step} {flip:.4}: frame {number} of the path")
    }
}

/// Prediction, frame and `map`, [height × width] FLIP of them.
pub(super) fn picture(frame: &Frame, warped: &Warped, map: &[f64]) -> Rgb8Image {
    let (width, height) = (frame.camera.width, frame.camera.height);
    let pixels = map.iter().zip(&warped.is_seen);
    let colours = pixels.map(|(&flip, &is_seen)| if is_seen { false_colour::ramp(flip as f32) } else { NOT_COMPARED });
    let [before, after] = [&warped.planes, &frame.planes].map(|planes| Rgb8Image::from_planes(planes, width, height));
    Rgb8Image::beside(&[before, after, Rgb8Image::from_pixels(width, height, colours)])
}
