//! The automatic end of growth: no Gaussians are added once validation views do not improve faster with them than without.
//!
//! Training improves a scene between two batches even if it does not grow. Intervals without a batch, the controls, show by
//! how much. A batch is worth what its interval has gained beyond them.

mod batch_gain;
#[cfg(test)]
mod tests;

use std::fmt;

use serde::{Deserialize, Serialize};

use batch_gain::{Batch, Excess, Interval, percent_of_error};
pub use batch_gain::{BatchGain, Mean, Verdict};

/// Gain by twice the primitives from which on a batch is worth it, dB: less cannot be seen. It is smaller than the gain that
/// is wanted in the end, as part of what a batch gains shows later.
const LEAST_GAIN: f64 = 0.05;
/// Most batches that are judged together while their worth is within its error of what is wanted: earlier ones say little
/// of a scene that has grown since.
const POOLED: usize = 4;
/// As many batches are judged by the value alone where one view leaves no error.
const WITHOUT_ERROR: usize = 2;

/// Intervals of a batch that is not clear: two until it has settled, and the control after it.
const OF_A_BATCH: usize = 3;

/// Batches that fit into `intervals` if none of them is clear. The budget is to be reached then, too.
pub fn batches_within(intervals: usize) -> usize {
    intervals.div_ceil(OF_A_BATCH)
}

/// The start of the next interval of growth.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Next {
    /// No new primitives, to see what training does alone.
    #[default]
    Control,
    /// A batch of new primitives.
    Batch,
    /// Growth has ended, and there are no more intervals.
    Nothing,
}

/// The history of growth, as far as decisions need it. It is part of a checkpoint; one of an earlier version has none, and
/// begins with a control.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Growth {
    next: Next,
    running: Option<Running>,
    /// The last interval without a batch.
    control: Option<Interval>,
    /// The last batch, if no control has followed yet.
    batch: Option<Batch>,
    /// Gains of the last batches, if they were within their errors.
    undecided: Vec<Excess>,
}

/// An interval that has not ended.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Running {
    /// Steps of the stage that were done.
    begin: usize,
    /// PSNR of each view before the new primitives, dB.
    psnr: Vec<f64>,
    /// Before the new ones.
    primitives: usize,
    added: usize,
    /// Whether a batch has been seen after one interval already, and settles for another.
    #[serde(default)]
    settles: bool,
}

/// The result of an interval.
#[derive(Clone, Debug, PartialEq)]
pub enum Finding {
    /// Mean rise of the PSNR of the views in `steps` without new primitives, dB.
    Control { rise: f64, steps: usize },
    /// The gain of a batch.
    Batch(BatchGain),
}

impl Growth {
    /// The start of the next interval.
    pub fn next(&self) -> Next {
        self.next
    }

    /// Begins an interval after `completed` steps of the stage: `psnr` is that of each view, dB, just before `added` new
    /// primitives join `primitives` others. Without new ones it is a control, whatever was wanted. Does nothing once growth
    /// has ended, nor while a batch settles.
    pub fn begin(&mut self, completed: usize, psnr: Vec<f64>, primitives: usize, added: usize) {
        if self.next != Next::Nothing && self.running.is_none() {
            self.running = Some(Running { begin: completed, psnr, primitives, added, settles: false });
        }
    }

    /// Whether an interval has begun and not ended.
    pub fn is_running(&self) -> bool {
        self.running.is_some()
    }

    /// Ends growth for good.
    pub fn finish(&mut self) {
        *self = Self { next: Next::Nothing, ..Self::default() };
    }

    /// Ends the interval after `completed` steps of the stage, when the views have `psnr`, dB, and decides what comes next. A
    /// batch is worth it from 0.05 dB on.
    ///
    /// Right after a batch only the control before it is known. As improvement slows down, that one rather promises too
    /// much; a batch that exceeds it clearly is followed by the next. Otherwise it settles: new primitives disturb a scene
    /// before they improve it, so the interval of the batch goes on for a second one. If the two do not exceed the control
    /// clearly either, another control follows, and those on both sides of the batch decide, by the rate between them that
    /// the trend has in the middle of the batch. While the worth of the last batches together is within its error of what is
    /// wanted, the scene goes on growing: a primitive too many costs less than detail that is missing.
    ///
    /// `None` if no interval was running, or if it showed nothing because a PSNR is not finite.
    pub fn end(&mut self, completed: usize, psnr: &[f64]) -> Option<Finding> {
        let running = self.running.take()?;
        let Some(interval) = running.ended(completed, psnr) else {
            self.next = Next::Control;
            return None;
        };
        if running.added > 0 {
            return self.end_batch(running, interval);
        }
        let before = self.control.replace(interval.clone());
        let Some((before, batch)) = before.zip(self.batch.take()) else {
            self.next = Next::Batch;
            return Some(Finding::Control { rise: interval.rise(), steps: interval.steps() });
        };
        let rises_without = batch.interval.rises_without(&before, Some(&interval));
        if self.undecided.len() == POOLED {
            self.undecided.remove(0);
        }
        let trend_error = batch.interval.trend_error(&before, &interval);
        self.undecided.push(Excess::new(&batch, &rises_without, trend_error));
        let (gain, batches) = (Excess::gain(&self.undecided), self.undecided.len());
        let by_value = gain.error.is_none() && batches >= WITHOUT_ERROR;
        let verdict = if gain.is_clearly_above(LEAST_GAIN) || (by_value && gain.value >= LEAST_GAIN) {
            self.undecided.clear();
            Verdict::GoesOn
        } else if gain.is_clearly_below(LEAST_GAIN) || by_value {
            Verdict::Stops
        } else {
            Verdict::Undecided
        };
        self.next = Next::Batch;
        if verdict == Verdict::Stops {
            self.finish();
        }
        Some(Finding::Batch(batch_gain(&batch, &rises_without, gain, batches, verdict)))
    }

    fn end_batch(&mut self, running: Running, interval: Interval) -> Option<Finding> {
        let doublings = (running.added as f64 / running.primitives.max(1) as f64).ln_1p() / 2f64.ln();
        let batch = Batch { interval, added: running.added, doublings };
        let rises_without = batch.interval.rises_without(self.control.as_ref()?, None);
        let gain = Excess::gain(&[Excess::new(&batch, &rises_without, 0.0)]);
        let verdict = if gain.is_clearly_above(LEAST_GAIN) {
            self.undecided.clear();
            self.next = Next::Batch;
            Verdict::GoesOn
        } else {
            self.next = Next::Control;
            if running.settles { Verdict::AwaitsControl } else { Verdict::Settles }
        };
        let found = batch_gain(&batch, &rises_without, gain, 1, verdict);
        if verdict == Verdict::Settles {
            self.running = Some(Running { settles: true, ..running });
        } else {
            self.batch = Some(batch);
        }
        Some(Finding::Batch(found))
    }
}

impl Running {
    /// The interval, if it has steps and all of its views have a finite PSNR before and after it.
    fn ended(&self, completed: usize, psnr: &[f64]) -> Option<Interval> {
        let rises: Vec<f64> = psnr.iter().zip(&self.psnr).map(|(after, before)| after - before).collect();
        let is_whole = !rises.is_empty() && rises.len() == self.psnr.len() && rises.iter().all(|rise| rise.is_finite());
        (is_whole && completed > self.begin).then_some(Interval { begin: self.begin, end: completed, rises })
    }
}

fn batch_gain(batch: &Batch, rises_without: &[f64], gain: Mean, batches: usize, verdict: Verdict) -> BatchGain {
    let rise = batch.interval.rise();
    BatchGain {
        added: batch.added,
        steps: batch.interval.steps(),
        rise,
        rise_without: Mean::of(rises_without).value,
        gain,
        batches,
        verdict,
    }
}

impl fmt::Display for Finding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Control { rise, steps } => {
                let percent = percent_of_error(*rise);
                write!(f, "validation error {percent:+.1} % in {steps} steps without new Gaussians: {rise:+.3} dB")
            }
            Self::Batch(gain) => gain.fmt(f),
        }
    }
}
