//! The gain of a batch of new primitives: how much more the views improve with it than without one.

use std::fmt;

use serde::{Deserialize, Serialize};

use super::LEAST_GAIN;

/// Steps of training between two evaluations of the same views.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Interval {
    /// Steps of the stage that were done when it began.
    pub begin: usize,
    /// The same when it ended, more than at its beginning.
    pub end: usize,
    /// Rise of the PSNR of each view, dB.
    pub rises: Vec<f64>,
}

/// Rate of a control over that of the one before it below which their ratio is taken for noise as far as the shape of the
/// trend between them goes.
const MOST_SLOWING: f64 = 1.0 / 3.0;

/// An interval that began with new primitives.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Batch {
    pub interval: Interval,
    /// Number of new primitives, at least 1.
    pub added: usize,
    /// Binary logarithm of the growth of the number of primitives: 1 for a batch of as many as there were.
    pub doublings: f64,
}

/// Improvement of each view by a batch beyond that of training alone.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Excess {
    /// dB of each view.
    pub views: Vec<f64>,
    /// See [`Batch::doublings`].
    pub doublings: f64,
    /// Error of what training alone would have given, common to all views, dB.
    #[serde(default)]
    pub trend_error: f64,
}

/// A mean over views.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mean {
    pub value: f64,
    /// Its error; `None` if there is one view only.
    pub error: Option<f64>,
}

/// The gain of a batch, and the verdict on it.
#[derive(Clone, Debug, PartialEq)]
pub struct BatchGain {
    /// Number of new primitives.
    pub added: usize,
    /// Length of the interval.
    pub steps: usize,
    /// Mean rise of the PSNR of the views, dB.
    pub rise: f64,
    /// Mean rise that training alone would have given, dB.
    pub rise_without: f64,
    /// Gain of the last batches, dB per doubling of the primitives.
    pub gain: Mean,
    /// Number of batches that `gain` is of.
    pub batches: usize,
    pub verdict: Verdict,
}

/// The consequence of a gain.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// It was worth it: the next one follows.
    GoesOn,
    /// It cannot be seen yet, and new primitives disturb at first: the interval goes on.
    Settles,
    /// It cannot be seen yet: an interval without a batch follows.
    AwaitsControl,
    /// The difference is within its error: another batch follows.
    Undecided,
    /// It was not worth it: growth stops.
    Stops,
}

impl Interval {
    pub fn steps(&self) -> usize {
        self.end - self.begin
    }

    /// Mean rise of the PSNR of the views, dB.
    pub fn rise(&self) -> f64 {
        mean(&self.rises)
    }

    /// Steps of the stage.
    fn middle(&self) -> f64 {
        0.5 * (self.begin + self.end) as f64
    }

    /// dB per step.
    fn rate(&self) -> f64 {
        self.rise() / self.steps() as f64
    }

    /// dB per step of each view.
    fn rates(&self) -> impl Iterator<Item = f64> {
        self.rises.iter().map(|rise| rise / self.steps() as f64)
    }

    /// Rise of each view in this interval without a batch, dB, at the rate of the control interval `before` it; with
    /// one `after` it as well, at the rate between them that the trend has in the middle of this interval. Where
    /// improvement slows down, it does so exponentially: a straight line between the two would promise too much.
    pub fn rises_without(&self, before: &Self, after: Option<&Self>) -> Vec<f64> {
        let after = after.unwrap_or(before);
        let span = after.middle() - before.middle();
        let share = if span > 0.0 { (self.middle() - before.middle()) / span } else { 0.0 };
        let [first, last] = [before, after].map(Self::rate);
        let slowing = if first > 0.0 { (last / first).clamp(MOST_SLOWING, 1.0) } else { 1.0 };
        let bend = slowing.powf(share) / (1.0 + share * (slowing - 1.0));
        let rates = before.rates().zip(after.rates()).map(|(before, after)| before + share * (after - before));
        rates.map(|rate| bend * rate * self.steps() as f64).collect()
    }

    /// Error of these rises that all views share, dB: training slows down, so a control `after` this interval that is faster
    /// than the one `before` shows by how much steps fluctuate.
    pub fn trend_error(&self, before: &Self, after: &Self) -> f64 {
        0.5 * (after.rate() - before.rate()).max(0.0) * self.steps() as f64
    }
}

impl Excess {
    /// The excess of `batch`, whose views would have risen by `rises_without` dB, with the error `trend_error`, dB.
    pub fn new(batch: &Batch, rises_without: &[f64], trend_error: f64) -> Self {
        let rises = batch.interval.rises.iter().zip(rises_without);
        let views = rises.map(|(rise, without)| rise - without).collect();
        Self { views, doublings: batch.doublings, trend_error }
    }

    /// dB per doubling, of `batches` together: noise of single batches averages out.
    pub fn gain(batches: &[Self]) -> Mean {
        let doublings: f64 = batches.iter().map(|batch| batch.doublings).sum();
        let views = batches.iter().map(|batch| batch.views.len()).min().unwrap_or(0);
        let of_view = |view: usize| batches.iter().map(|batch| batch.views[view]).sum::<f64>() / doublings;
        let mean = Mean::of(&(0..views).map(of_view).collect::<Vec<_>>());
        let of_trend = batches.iter().map(|batch| batch.trend_error.powi(2)).sum::<f64>().sqrt() / doublings;
        Mean { error: mean.error.map(|error| error.hypot(of_trend)), ..mean }
    }
}

impl Mean {
    /// Mean of at least one view.
    pub fn of(views: &[f64]) -> Self {
        let (value, count) = (mean(views), views.len() as f64);
        let squares: f64 = views.iter().map(|view| (view - value).powi(2)).sum();
        let error = (views.len() > 1).then(|| (squares / (count - 1.0) / count).sqrt());
        Self { value, error }
    }

    /// Mean of the changes of the views from `before` to `after`, which have at least one.
    pub fn of_changes(before: &[f64], after: &[f64]) -> Self {
        Self::of(&after.iter().zip(before).map(|(after, before)| after - before).collect::<Vec<_>>())
    }

    /// Whether it is at least `limit`, by its standard error or more.
    pub fn is_clearly_above(self, limit: f64) -> bool {
        self.error.is_some_and(|error| self.value - error >= limit)
    }

    /// Whether it is below `limit`, by more than its standard error.
    pub fn is_clearly_below(self, limit: f64) -> bool {
        self.error.is_some_and(|error| self.value + error < limit)
    }
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

/// By how many percent the squared error changes, in the geometric mean over views whose PSNR rises by `rise` dB.
pub fn percent_of_error(rise: f64) -> f64 {
    100.0 * (10f64.powf(-rise / 10.0) - 1.0)
}

impl fmt::Display for Mean {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.error {
            Some(error) => write!(f, "{:+.3} ± {error:.3} dB", self.value),
            None => write!(f, "{:+.3} dB", self.value),
        }
    }
}

impl fmt::Display for BatchGain {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { added, steps, rise, rise_without, gain, batches, verdict } = self;
        let [with, without] = [*rise, *rise_without].map(percent_of_error);
        write!(f, "batch of {added} Gaussians: validation error {with:+.1} % in {steps} steps, ")?;
        write!(f, "{without:+.1} % without one: {:+.3} dB; {gain} for twice the primitives", rise - rise_without)?;
        if *batches > 1 {
            write!(f, " by the last {batches} batches")?;
        }
        write!(f, ", at least {LEAST_GAIN} wanted: ")?;
        f.write_str(match verdict {
            Verdict::GoesOn => "the scene goes on growing",
            Verdict::Settles => "not clear yet, so the batch is given time to settle",
            Verdict::AwaitsControl => "not clear yet, so an interval without a batch follows",
            Verdict::Undecided => "undecided, so another batch follows",
            Verdict::Stops => "growth stops",
        })
    }
}
