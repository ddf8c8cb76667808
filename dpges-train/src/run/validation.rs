//! Early stopping: when a run that validation views judge has learnt enough.

use serde::{Deserialize, Serialize};

/// The best that validation views have shown so far.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Validation {
    best: Option<Best>,
    /// Number of evaluations since then.
    since: usize,
    stopped: bool,
    /// PSNR of the scene that the last stage began with, dB; `None` without validation views or an earlier stage.
    pub(super) before_last_stage: Option<f64>,
}

#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
struct Best {
    step: usize,
    /// dB
    psnr: f64,
}

/// The verdict of an evaluation of the validation views.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Verdict {
    Best,
    /// It was better before; this is the `since`th evaluation that did not improve it.
    Worse {
        since: usize,
        best_step: usize,
        best_psnr: f64,
    },
    /// It has not improved for `patience` evaluations: the run ends.
    Enough {
        best_step: usize,
        best_psnr: f64,
    },
}

impl Validation {
    /// Waits for a better one again, if it had stopped to.
    pub fn go_on(&mut self) {
        (self.since, self.stopped) = (0, false);
    }

    /// Takes note of the mean PSNR of the validation views after `step` steps, dB. The run ends after `patience`
    /// evaluations without a better one.
    pub fn observe(&mut self, step: usize, psnr: f64, patience: usize) -> Verdict {
        match self.best {
            Some(best) if psnr <= best.psnr => {
                self.since += 1;
                let (best_step, best_psnr) = (best.step, best.psnr);
                if self.since >= patience {
                    self.stopped = true;
                    return Verdict::Enough { best_step, best_psnr };
                }
                Verdict::Worse { since: self.since, best_step, best_psnr }
            }
            _ => {
                self.best = Some(Best { step, psnr });
                self.since = 0;
                Verdict::Best
            }
        }
    }

    /// Whether the run has ended.
    pub fn stopped(&self) -> bool {
        self.stopped
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_is_enough_after_as_many_worse_ones_as_patience() {
        let mut validation = Validation::default();
        assert_eq!(validation.observe(100, 20.0, 2), Verdict::Best);
        assert_eq!(validation.observe(200, 19.0, 2), Verdict::Worse { since: 1, best_step: 100, best_psnr: 20.0 });
        assert_eq!(validation.observe(300, 21.0, 2), Verdict::Best);
        assert_eq!(validation.observe(400, 21.0, 2), Verdict::Worse { since: 1, best_step: 300, best_psnr: 21.0 });
        assert!(!validation.stopped());
        assert_eq!(validation.observe(500, 20.0, 2), Verdict::Enough { best_step: 300, best_psnr: 21.0 });
        assert!(validation.stopped());
    }
}
