//! Times of frames, for the graph.

use std::collections::VecDeque;

use crate::PassTime;
use crate::percentile::percentiles;

const KEPT: usize = 240;

#[derive(Clone, Debug, PartialEq)]
pub struct FrameTime {
    /// From the frame before, ms; `None` if there was a pause between them.
    pub wall_ms: Option<f64>,
    /// Empty where the GPU has no clock.
    pub passes: Vec<PassTime>,
}

impl FrameTime {
    pub fn gpu_ms(&self) -> Option<f64> {
        (!self.passes.is_empty()).then(|| self.passes.iter().map(|pass| pass.milliseconds).sum())
    }

    /// The time of the frame: by the GPU's clock, or else by the wall's.
    pub fn ms(&self) -> Option<f64> {
        self.gpu_ms().or(self.wall_ms)
    }
}

/// The last frames, oldest first.
#[derive(Clone, Debug, Default)]
pub struct FrameTimes(VecDeque<FrameTime>);

impl FrameTimes {
    pub fn push(&mut self, frame: FrameTime) {
        if self.0.len() == KEPT {
            self.0.pop_front();
        }
        self.0.push_back(frame);
    }

    pub fn last(&self) -> Option<&FrameTime> {
        self.0.back()
    }

    /// Median of the last frames that followed one another, frames per second.
    pub fn frames_per_second(&self) -> Option<f64> {
        let times = self.0.iter().rev().take(10).filter_map(|frame| frame.wall_ms);
        percentiles(times.collect(), [0.5]).map(|[ms]| 1e3 / ms)
    }

    /// Points (frame, ms).
    pub fn line(&self, value: impl Fn(&FrameTime) -> Option<f64>) -> Vec<[f64; 2]> {
        self.0.iter().enumerate().filter_map(|(at, frame)| Some([at as f64, value(frame)?])).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frame(wall_ms: Option<f64>, passes: &[(&'static str, f64)]) -> FrameTime {
        let pass = |&(name, milliseconds): &(&'static str, f64)| PassTime { name, milliseconds };
        FrameTime { wall_ms, passes: passes.iter().map(pass).collect() }
    }

    #[test]
    fn the_gpu_counts_before_the_wall() {
        assert_eq!(frame(Some(16.0), &[("peel", 2.0), ("splat", 3.0)]).ms(), Some(5.0));
        assert_eq!(frame(Some(16.0), &[]).ms(), Some(16.0));
        assert_eq!(frame(None, &[]).ms(), None);
    }

    #[test]
    fn the_oldest_frames_are_forgotten_and_pauses_leave_gaps() {
        let mut times = FrameTimes::default();
        assert_eq!((times.frames_per_second(), times.last()), (None, None));
        (0..KEPT + 5).for_each(|at| times.push(frame((at % 2 == 0).then_some(20.0), &[("peel", at as f64)])));
        assert_eq!(times.line(FrameTime::gpu_ms).len(), KEPT);
        assert_eq!(times.line(FrameTime::gpu_ms)[0], [0.0, 5.0]);
        assert_eq!(times.line(|frame| frame.wall_ms).len(), KEPT / 2);
        assert_eq!(times.frames_per_second(), Some(50.0));
    }
}
