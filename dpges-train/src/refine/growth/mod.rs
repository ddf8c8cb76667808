//! The automatic end of growth: no Gaussians are added once validation views do not improve faster with them than without.
//!
//! Training improves a scene between two batches even if it does not grow. Intervals without a batch, the controls, show by
//! how much. A batch is worth what its interval has gained beyond them.

#[cfg(test)]
mod tests;
mod worth;

use std::fmt;

use serde::{Deserialize, Serialize};

use worth::{Batch, Excess, Interval, percent_of_error};
pub use worth::{Mean, Verdict, Worth};

/// Batches whose worth is within its error of what is wanted are judged together; as many as these are judged by the
/// value alone.
const UNDECIDED: usize = 2;

/// What the next interval of growth begins with.
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
    /// What the last batches were worth, if that was within its error.
    undecided: Vec<Excess>,
}

/// An interval that has not ended.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Running {
    /// Steps of the stage that were done.
    begin: usize,
    /// Of each view before the new primitives, dB.
    psnr: Vec<f64>,
    /// Before the new ones.
    primitives: usize,
    added: usize,
}

/// What an interval has shown.
#[derive(Clone, Debug, PartialEq)]
pub enum Finding {
    /// By how much the PSNR of the views rose in `steps` without new primitives in the mean, dB.
    Control { rise: f64, steps: usize },
    /// What a batch was worth.
    Batch(Worth),
}

impl Growth {
    /// What the next interval begins with.
    pub fn next(&self) -> Next {
        self.next
    }

    /// Begins an interval after `completed` steps of the stage: `psnr` is that of each view, dB, just before `added` new
    /// primitives join `primitives` others. Without new ones it is a control, whatever was wanted. Does nothing once growth
    /// has ended.
    pub fn begin(&mut self, completed: usize, psnr: Vec<f64>, primitives: usize, added: usize) {
        self.running = (self.next != Next::Nothing).then_some(Running { begin: completed, psnr, primitives, added });
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
    /// batch is worth it from `least_gain` dB per doubling of the primitives on.
    ///
    /// Right after a batch only the control before it is known. As improvement slows down, that one rather promises too
    /// much; a batch that exceeds it clearly is followed by the next. Otherwise a control follows, and the two on both sides
    /// of the batch decide, by the rate between them that the trend has in the middle of the batch.
    ///
    /// `None` if no interval was running, or if it showed nothing because a PSNR is not finite.
    pub fn end(&mut self, completed: usize, psnr: &[f64], least_gain: f64) -> Option<Finding> {
        let running = self.running.take()?;
        let Some(interval) = running.ended(completed, psnr) else {
            self.next = Next::Control;
            return None;
        };
        if running.added > 0 {
            let doublings = (running.added as f64 / running.primitives.max(1) as f64).ln_1p() / 2f64.ln();
            return self.end_batch(Batch { interval, added: running.added, doublings }, least_gain);
        }
        let before = self.control.replace(interval.clone());
        let Some((before, batch)) = before.zip(self.batch.take()) else {
            self.next = Next::Batch;
            return Some(Finding::Control { rise: interval.rise(), steps: interval.steps() });
        };
        let rises_without = batch.interval.rises_without(&before, Some(&interval));
        self.undecided.push(Excess::new(&batch, &rises_without));
        let (gain, batches) = (Excess::gain(&self.undecided), self.undecided.len());
        let verdict = if gain.is_clearly_above(least_gain) {
            self.undecided.clear();
            Verdict::GoesOn
        } else if gain.is_clearly_below(least_gain) {
            Verdict::Stops
        } else if batches < UNDECIDED {
            Verdict::Undecided
        } else if gain.value >= least_gain {
            self.undecided.remove(0);
            Verdict::GoesOn
        } else {
            Verdict::Stops
        };
        self.next = Next::Batch;
        if verdict == Verdict::Stops {
            self.finish();
        }
        Some(Finding::Batch(worth(&batch, &rises_without, gain, batches, least_gain, verdict)))
    }

    fn end_batch(&mut self, batch: Batch, least_gain: f64) -> Option<Finding> {
        let rises_without = batch.interval.rises_without(self.control.as_ref()?, None);
        let gain = Excess::gain(&[Excess::new(&batch, &rises_without)]);
        let verdict = if gain.is_clearly_above(least_gain) {
            self.undecided.clear();
            self.next = Next::Batch;
            Verdict::GoesOn
        } else {
            self.next = Next::Control;
            Verdict::AwaitsControl
        };
        let found = worth(&batch, &rises_without, gain, 1, least_gain, verdict);
        self.batch = Some(batch);
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

fn worth(batch: &Batch, rises_without: &[f64], gain: Mean, batches: usize, least_gain: f64, verdict: Verdict) -> Worth {
    let rise = batch.interval.rise();
    Worth {
        added: batch.added,
        steps: batch.interval.steps(),
        rise,
        rise_without: Mean::of(rises_without).value,
        gain,
        batches,
        least_gain,
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
            Self::Batch(worth) => worth.fmt(f),
        }
    }
}
