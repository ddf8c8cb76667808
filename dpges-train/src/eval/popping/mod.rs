//! Popping: how much the picture of a moving camera changes where the motion does not explain it.
//!
//! A frame is compared with an earlier one as it would look from the later camera, by FLIP, where both show the same
//! surface (Radl, Steiner, Parger, Weinrauch, Kerbl, Steinberger: *StopThePop: Sorted Gaussian Splatting for View-Consistent
//! Real-time Rendering*. SIGGRAPH 2024). They estimate the motion of pixels with a network; here it follows from depth and
//! cameras. `docs/guide/measure.md` says what else differs.

mod arc;
mod frame;
mod jumps;
#[cfg(test)]
mod tests;
mod worst;

use std::collections::VecDeque;

use dpges_core::Result;
use dpges_core::camera::Camera;
use dpges_core::scene::SceneInfo;
use serde::{Deserialize, Serialize};

use crate::dataset::Dataset;
use crate::eval::rendered::TrainingRenderer;
use crate::metrics::flip_map;
pub use arc::{FRAMES, arc, turn_about_the_middle};
pub use frame::{Frame, Warped};
pub use jumps::{Causes, Jumps};
pub use worst::WorstFrame;

/// Frames between those that are compared.
const STEPS: [usize; 2] = [1, 7];

/// How much a scene pops along a path.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Popping {
    /// FLIP of frames and those before them, from 0 to 1, mean over the frames.
    pub flip_1: f64,
    /// The same of frames and those 7 before them.
    pub flip_7: f64,
    pub frames: usize,
    /// Share of the pixels that were compared, from 0 to 1: for `flip_1` and for `flip_7`, means over the frames.
    pub pixels_compared: [f64; 2],
    /// Along another path, in much smaller steps; absent of older reports.
    #[serde(flatten)]
    pub jumps: Option<Jumps>,
}

/// Popping, and the frames 1 and 7 after another that pop most.
#[derive(Clone, Debug, PartialEq)]
pub struct Measured {
    pub popping: Popping,
    pub worst: [WorstFrame; 2],
}

impl Measured {
    /// Popping of `renderer` along the [arc](fn@arc) of `dataset`, and jumps [about its middle](turn_about_the_middle), both in the
    /// coordinates of the scene with `info`; `None` if no surface is seen twice.
    ///
    /// # Errors
    /// Those of [`arc`](fn@arc) and of [`TrainingRenderer::render`].
    pub fn of_scene(renderer: &TrainingRenderer, dataset: &Dataset, info: &SceneInfo) -> Result<Option<Self>> {
        let Some(mut measured) = Self::along(renderer, &arc(dataset, info)?)? else { return Ok(None) };
        measured.popping.jumps = Some(Jumps::along(renderer, turn_about_the_middle(dataset, info)?)?);
        Ok(Some(measured))
    }

    /// Popping of the frames of `renderer` along `path`, in the coordinates of its scene; `None` if no surface is seen
    /// twice, or with fewer than 8 cameras.
    pub fn along(renderer: &TrainingRenderer, path: &[Camera]) -> Result<Option<Self>> {
        Self::of(path.iter().map(|camera| Frame::render(renderer, camera)))
    }

    /// Popping of `frames`, which have one size; `None` if no surface is seen twice, or with fewer than 8 of them.
    ///
    /// # Errors
    /// The first of `frames`.
    ///
    /// # Panics
    /// If frames differ in size.
    pub fn of<E>(frames: impl IntoIterator<Item = Result<Frame, E>>) -> Result<Option<Self>, E> {
        let mut all_pairs = STEPS.map(|_| Pairs::default());
        let mut earlier: VecDeque<Frame> = VecDeque::new();
        let mut count = 0;
        for frame in frames {
            let frame = frame?;
            for (pairs, step) in all_pairs.iter_mut().zip(STEPS) {
                if let Some(at) = earlier.len().checked_sub(step) {
                    pairs.add(&frame, &earlier[at], count, step);
                }
            }
            earlier.push_back(frame);
            if earlier.len() > STEPS[1] {
                earlier.pop_front();
            }
            count += 1;
        }
        let [Some(flip_1), Some(flip_7)] = all_pairs.each_ref().map(|pairs| mean(&pairs.flips)) else {
            return Ok(None);
        };
        let pixels_compared = all_pairs.each_ref().map(|pairs| mean(&pairs.shares).unwrap_or(0.0));
        let worst = all_pairs.map(|pairs| pairs.worst.expect("a mean is of at least one pair"));
        Ok(Some(Self { popping: Popping { flip_1, flip_7, frames: count, pixels_compared, jumps: None }, worst }))
    }
}

/// Pairs of frames that are as far apart.
#[derive(Default)]
struct Pairs {
    /// FLIP of those with pixels to compare.
    flips: Vec<f64>,
    /// Shares of pixels that were compared.
    shares: Vec<f64>,
    worst: Option<WorstFrame>,
}

impl Pairs {
    /// `frame` is number `number` of the path, counted from 0, and `step` after `earlier`.
    fn add(&mut self, frame: &Frame, earlier: &Frame, number: usize, step: usize) {
        let warped = frame.warped(earlier);
        let count = warped.is_seen.iter().filter(|&&is_seen| is_seen).count();
        self.shares.push(count as f64 / warped.is_seen.len().max(1) as f64);
        if count > 0 {
            let map = flip_map(&frame.planes, &warped.planes, frame.camera.width, frame.camera.height);
            let seen = map.iter().zip(&warped.is_seen).filter(|(_, is_seen)| **is_seen);
            let flip = seen.map(|(flip, _)| flip).sum::<f64>() / count as f64;
            self.flips.push(flip);
            if self.worst.as_ref().is_none_or(|worst| flip > worst.flip) {
                self.worst = Some(WorstFrame { flip, number, step, picture: worst::picture(frame, &warped, &map) });
            }
        }
    }
}

fn mean(values: &[f64]) -> Option<f64> {
    (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
}
