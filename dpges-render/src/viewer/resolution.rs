//! How many pixels a frame has: chosen, or as many as hold a frame rate.

/// Smallest share of the window's pixels along an edge.
pub const LEAST_SCALE: f64 = 0.25;
/// Frames whose median decides, at most.
const WINDOW: usize = 8;
/// Fewer decide if they took this long together, ms.
const LONG_ENOUGH: f64 = 500.0;
/// Frame times, in parts of the goal, between which nothing changes.
const HELD: std::ops::RangeInclusive<f64> = 0.6..=1.1;
/// Frame time that a change aims at, in parts of the goal.
const AIM: f64 = 0.85;
/// Smallest and largest factor of the scale at once.
const CHANGE: [f64; 2] = [0.4, 1.4];

/// Chooses the scale of the picture by the time that frames take. Time grows with the square of the scale, so that a
/// change lands between the limits within which nothing changes.
#[derive(Clone, Debug)]
pub struct ResolutionControl {
    scale: f64,
    times: Vec<f64>,
    /// Time that a frame of all pixels would take, ms; `None` before it is known.
    full_ms: Option<f64>,
}

/// Longest frame, ms, that is drawn for the sake of sharpness once the view rests.
const LONGEST_AT_REST: f64 = 400.0;

impl Default for ResolutionControl {
    fn default() -> Self {
        Self { scale: 1.0, times: Vec::new(), full_ms: None }
    }
}

impl ResolutionControl {
    pub fn scale(&self) -> f64 {
        self.scale
    }

    /// The scale of a view that rests: all pixels, unless that takes too long.
    pub fn scale_at_rest(&self) -> f64 {
        if self.full_ms.is_none_or(|full| full < LONGEST_AT_REST) { 1.0 } else { self.scale }
    }

    /// Takes note of a frame at the present scale that took `milliseconds`; the goal is `goal` milliseconds.
    pub fn observe(&mut self, milliseconds: f64, goal: f64) {
        self.times.push(milliseconds / goal);
        if self.times.len() < WINDOW && self.times.iter().sum::<f64>() * goal < LONG_ENOUGH {
            return;
        }
        self.times.sort_unstable_by(f64::total_cmp);
        let median = self.times[self.times.len() / 2];
        self.times.clear();
        self.full_ms = Some(median * goal / self.scale.powi(2));
        if !HELD.contains(&median) {
            let change = (AIM / median).sqrt().clamp(CHANGE[0], CHANGE[1]);
            self.scale = (self.scale * change).clamp(LEAST_SCALE, 1.0);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Frames at a cost of `full` ms at scale 1, and the scales after each.
    fn run(control: &mut ResolutionControl, full: f64, frames: usize) -> Vec<f64> {
        let frame = |control: &mut ResolutionControl| {
            control.observe(full * control.scale().powi(2), 20.0);
            control.scale()
        };
        (0..frames).map(|_| frame(control)).collect()
    }

    #[test]
    fn slow_frames_get_smaller_until_the_rate_is_held_and_then_nothing_changes() {
        let mut control = ResolutionControl::default();
        let scales = run(&mut control, 120.0, 200);
        let last = *scales.last().unwrap();
        assert!(HELD.contains(&(120.0 * last * last / 20.0)), "{last}");
        assert!(scales[60..].iter().all(|&scale| scale == last), "it swings: {scales:?}");
    }

    #[test]
    fn quick_frames_get_larger_but_not_larger_than_the_window() {
        let mut control = ResolutionControl::default();
        run(&mut control, 500.0, 200);
        assert!(control.scale() < 0.3);
        run(&mut control, 5.0, 200);
        assert_eq!(control.scale(), 1.0);
        run(&mut control, 1e6, 200);
        assert_eq!(control.scale(), LEAST_SCALE);
    }

    #[test]
    fn very_slow_frames_are_answered_at_once() {
        let mut control = ResolutionControl::default();
        assert!(run(&mut control, 2000.0, 1)[0] < 0.5);
    }

    #[test]
    fn a_single_slow_frame_changes_nothing() {
        let mut control = ResolutionControl::default();
        for frame in 0..100 {
            control.observe(if frame % 8 == 3 { 300.0 } else { 15.0 }, 20.0);
        }
        assert_eq!(control.scale(), 1.0);
    }

    #[test]
    fn a_view_at_rest_is_sharp_unless_that_takes_too_long() {
        for (full, sharp) in [(120.0, true), (2000.0, false)] {
            let mut control = ResolutionControl::default();
            assert_eq!(control.scale_at_rest(), 1.0);
            run(&mut control, full, 200);
            assert_eq!(control.scale_at_rest() == 1.0, sharp, "{full}");
        }
    }

    #[test]
    fn times_about_the_goal_change_nothing() {
        let mut control = ResolutionControl { scale: 0.5, ..ResolutionControl::default() };
        for milliseconds in [13.0, 19.0, 21.0, 12.5] {
            (0..WINDOW).for_each(|_| control.observe(milliseconds, 20.0));
        }
        assert_eq!(control.scale(), 0.5);
    }
}
