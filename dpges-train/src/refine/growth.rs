//! How an automatic budget grows: the size of its batches, and their end by early stopping on the views that judge.

use serde::{Deserialize, Serialize};

use super::add::geometric_batch_size;

/// Patience of early stopping: growth ends after so many batches in a row without a better PSNR of the views that
/// judge, half of those in the schedule. In short runs a few views vary by 0.4 dB from batch to batch while they
/// improve.
const PATIENCE: usize = 5;

/// The history of growth. It is part of a checkpoint.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Growth {
    /// Number of primitives that batches have aimed at so far.
    wanted: usize,
    /// Best PSNR of the views that judge before a batch, dB.
    best_psnr: Option<f64>,
    /// Batches since.
    since_best: usize,
    has_ended: bool,
}

impl Growth {
    /// The growth of a scene that has so many `primitives`.
    pub fn of(primitives: usize) -> Self {
        Self { wanted: primitives, ..Self::default() }
    }

    /// Number of primitives that the scene is to have. Fewer of them draw after a while: new ones take the place of others.
    pub fn wanted(&self) -> usize {
        self.wanted
    }

    pub fn has_ended(&self) -> bool {
        self.has_ended
    }

    /// Decides about the first of `batches_left` batches, the last of which reaches the `budget`. Before it, the views that judge
    /// have a mean PSNR of `psnr` dB and the scene has so many `primitives`. Returns a sentence about it.
    pub fn judge(&mut self, psnr: f64, primitives: usize, budget: usize, batches_left: usize) -> String {
        // early stopping: a batch that is no better counts against patience, and one that is starts it anew
        let known = self.best_psnr.filter(|best| psnr <= *best);
        let verdict = match known {
            Some(best) => {
                self.since_best += 1;
                self.has_ended = self.since_best == PATIENCE;
                format!("not above {best:.2} dB, {} of {PATIENCE}", self.since_best)
            }
            None => {
                (self.best_psnr, self.since_best) = (Some(psnr), 0);
                "the best so far".to_owned()
            }
        };
        // what has faded since is wanted still
        self.wanted = self.wanted.max(primitives);
        if !self.has_ended {
            self.wanted += geometric_batch_size(budget, self.wanted, batches_left);
        }
        let grows = if self.has_ended { "growth stops at" } else { "growth to" };
        format!("PSNR {psnr:.2} dB, {verdict}: {grows} {} of at most {budget} primitives", self.wanted)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Numbers of primitives that batches aim at, from 1000 up to 4000; the views that judge have `psnrs`, dB, before them.
    fn aims(psnrs: &[f64]) -> (Vec<usize>, Growth) {
        let mut growth = Growth::of(1000);
        let aims = psnrs.iter().enumerate().map(|(at, &psnr)| {
            if !growth.has_ended() {
                // some do not draw any more
                growth.judge(psnr, growth.wanted() - 50, 4000, psnrs.len() - at);
            }
            growth.wanted()
        });
        (aims.collect(), growth)
    }

    #[test]
    fn a_scene_that_improves_grows_by_equal_factors_to_its_limit() {
        let (aims, growth) = aims(&[20.0, 20.5, 20.4, 20.6]);
        assert_eq!(aims, [1414, 2000, 2828, 4000]);
        assert!(!growth.has_ended());
    }

    #[test]
    fn growth_ends_where_views_do_not_improve() {
        let (found, growth) = aims(&[20.0, 19.0, 20.0, 20.1, 20.1, 20.05, 19.9, 20.0, 19.8, 30.0]);
        assert_eq!(found[7..], [found[7]; 3]);
        assert!(growth.has_ended() && found[7] > found[6] && found[7] < 4000, "{found:?}");
    }

    #[test]
    fn a_psnr_that_is_not_finite_ends_nothing() {
        assert_eq!(aims(&[f64::NAN, 20.0, f64::NAN, f64::NAN]).0, [1414, 2000, 2828, 4000]);
    }

    #[test]
    fn a_scene_that_has_grown_by_itself_is_not_made_smaller() {
        let mut growth = Growth::of(1000);
        growth.judge(20.0, 3000, 4000, 2);
        assert_eq!(growth.wanted(), 3464);
    }

    #[test]
    fn a_history_goes_on_where_it_was_saved() {
        let (_, growth) = aims(&[20.0, 20.5, 20.4]);
        let again: Growth = serde_json::from_str(&serde_json::to_string(&growth).unwrap()).unwrap();
        assert_eq!(again, growth);
    }

    #[test]
    fn sentences_say_what_was_decided_and_why() {
        let mut growth = Growth::of(1000);
        let told = [20.0, 19.5, 19.0, 18.0, 17.0, 16.0].map(|psnr| growth.judge(psnr, 0, 4000, 4));
        assert_eq!(told[0], "PSNR 20.00 dB, the best so far: growth to 1414 of at most 4000 primitives");
        assert!(told[1].starts_with("PSNR 19.50 dB, not above 20.00 dB, 1 of 5: growth to "), "{told:?}");
        assert!(told[5].contains("5 of 5: growth stops at 2879 of at most 4000"), "{told:?}");
    }
}
