//! The automatic end of growth: no Gaussians are added once they no longer improve validation views.

use std::fmt;

use serde::{Deserialize, Serialize};

/// dB of validation PSNR per 1 % more primitives below which a batch did not pay. It is a third of a decibel for twice
/// the primitives, that is, for twice the size of the scene.
pub const MIN_GAIN_DB_PER_PERCENT: f64 = 0.005;

/// Batches in a row that must not have paid: PSNR wavers from one evaluation to the next, and a single batch may have
/// come while the scene was still recovering from a pruning.
pub const BATCHES: usize = 2;

/// A scene just before a batch was added: number of primitives, validation PSNR in dB.
pub type Point = (usize, f64);

/// The history of growth. It is part of a checkpoint.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Growth {
    /// Each has more primitives than the one before.
    points: Vec<Point>,
}

/// Whether to add another batch.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Decision {
    Grow,
    Stop(Stop),
}

/// Why growth stopped.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stop {
    /// The last batches lie between them.
    pub points: [Point; BATCHES + 1],
    /// dB per 1 % more primitives, of each of these batches.
    pub gains: [f64; BATCHES],
}

impl Growth {
    /// Call it before every batch, with what the last batch has become: the number of primitives and their PSNR in dB
    /// over the validation views.
    ///
    /// Training improves a scene between two batches even if it does not grow. The gain is attributed to the batch, so
    /// growth ends late rather than early. A scene that is not larger than earlier ones replaces them. A PSNR that is
    /// not finite is ignored. Growth that has stopped does not start again.
    pub fn observe(&mut self, primitives: usize, validation_psnr: f64) -> Decision {
        if self.decision() == Decision::Grow && validation_psnr.is_finite() {
            while self.points.last().is_some_and(|&(before, _)| before >= primitives) {
                self.points.pop();
            }
            self.points.push((primitives, validation_psnr));
        }
        self.decision()
    }

    /// The decision after the last observation.
    pub fn decision(&self) -> Decision {
        let Some(&points) = self.points.last_chunk::<{ BATCHES + 1 }>() else { return Decision::Grow };
        let gains: [f64; BATCHES] = std::array::from_fn(|batch| gain(points[batch], points[batch + 1]));
        if gains.iter().all(|&gain| gain < MIN_GAIN_DB_PER_PERCENT) {
            Decision::Stop(Stop { points, gains })
        } else {
            Decision::Grow
        }
    }
}

/// dB per 1 % more primitives. Percents compound: 10 times as many are 231.4 times 1 % more.
fn gain(before: Point, after: Point) -> f64 {
    let percents = (after.0 as f64 / before.0.max(1) as f64).ln() / 1.01f64.ln();
    (after.1 - before.1) / percents
}

impl fmt::Display for Stop {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "growth stops: ")?;
        for (batch, gain) in self.gains.iter().enumerate() {
            let ((few, worse), (many, better)) = (self.points[batch], self.points[batch + 1]);
            write!(f, "from {few} to {many} primitives validation PSNR went from {worse:.2} to {better:.2} dB, ")?;
            write!(f, "{gain:.4} dB per 1 % more; ")?;
        }
        write!(f, "less than {MIN_GAIN_DB_PER_PERCENT} each time")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The decisions after each of `points`.
    fn decisions(points: &[Point]) -> (Growth, Vec<bool>) {
        let mut growth = Growth::default();
        let grows = points.iter().map(|&(count, psnr)| growth.observe(count, psnr) == Decision::Grow).collect();
        (growth, grows)
    }

    #[test]
    fn growth_stops_after_two_batches_that_did_not_pay() {
        // 1 % more each time, so that the gain is the difference
        let (growth, grows) = decisions(&[(10_000, 20.0), (10_100, 20.006), (10_201, 20.010), (10_303, 20.0149)]);
        assert_eq!(grows, [true, true, true, false]);
        let Decision::Stop(stop) = growth.decision() else { panic!("still growing") };
        assert_eq!(stop.points, [(10_100, 20.006), (10_201, 20.010), (10_303, 20.0149)]);
        assert!((stop.gains[0] - 0.004).abs() < 1e-9 && (stop.gains[1] - 0.0049).abs() < 1e-5, "{stop:?}");
        let text = stop.to_string();
        for part in ["from 10100 to 10201 primitives", "20.01 to 20.01 dB", "0.0040 dB per 1 %", "0.0049", "than 0.005"]
        {
            assert!(text.contains(part), "{text}");
        }
    }

    #[test]
    fn a_batch_that_paid_starts_the_count_again() {
        let (_, grows) = decisions(&[(1000, 20.0), (1010, 20.001), (1020, 20.1), (1030, 20.101), (1040, 19.9)]);
        assert_eq!(grows, [true, true, true, true, false]);
    }

    #[test]
    fn percents_compound() {
        // twice as many is 69.66 times 1 % more: 0.35 dB are 0.00502 dB each, 0.34 dB are 0.00488
        let doubling = |gained: f64| decisions(&[(500, 20.0), (1000, 20.0), (2000, 20.0 + gained)]).1[2];
        assert!(doubling(0.35) && !doubling(0.34));
    }

    #[test]
    fn scenes_that_did_not_grow_replace_the_one_before() {
        let shrunk = [(1000, 20.0), (1500, 20.0), (1200, 20.0), (1400, 25.0), (1400, 26.0), (1600, 26.0)];
        let (growth, grows) = decisions(&shrunk);
        assert_eq!(grows, [true; 6]);
        assert_eq!(growth.points, [(1000, 20.0), (1200, 20.0), (1400, 26.0), (1600, 26.0)]);
        let (growth, grows) = decisions(&[(0, 5.0), (10, f64::NAN), (20, 5.0), (30, 5.0)]);
        assert_eq!(grows, [true, true, true, false]);
        assert_eq!(growth.points, [(0, 5.0), (20, 5.0), (30, 5.0)]);
    }

    #[test]
    fn what_stopped_stays_stopped_even_when_read_back() {
        let (growth, grows) = decisions(&[(100, 20.0), (200, 20.0), (300, 20.0)]);
        assert_eq!(grows, [true, true, false]);
        let mut again: Growth = serde_json::from_str(&serde_json::to_string(&growth).unwrap()).unwrap();
        assert_eq!(again, growth);
        assert_eq!(again.observe(300, 40.0), growth.decision());
        assert_eq!(again, growth);
    }
}
