use std::f64::consts::LN_2;

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use super::*;
use crate::refine::add::geometric_batch_size;
use crate::refine::normal;

/// Primitives before the first batch, and the most.
const PRIMITIVES: (usize, usize) = (1000, 4000);
/// Primitives after one batch of the four that fill the budget.
const AFTER_ONE: usize = 1414;
/// Slots as long as an interval: the first control, the first batch, and the end.
const SLOTS: (usize, usize, usize) = (2, 3, 13);
const INTERVAL: usize = 1000;

/// The properties of a scene whose growth is decided about.
struct Course {
    /// PSNR by training alone after so many intervals, dB.
    trend: fn(f64) -> f64,
    /// dB that a doubling gains, four fifths of it in one interval.
    of_doubling: f64,
    /// dB that a doubling costs after one interval, a fifth of it after two.
    disturbance: f64,
    /// Noise of a single evaluation of one view, dB.
    noise: f64,
    views: usize,
}

/// The result of a course.
struct Outcome {
    verdicts: Vec<Verdict>,
    primitives: usize,
    growth: Growth,
}

impl Course {
    fn run(&self, seed: u64) -> Outcome {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let (mut growth, mut verdicts) = (Growth::default(), Vec::new());
        let (mut primitives, budget) = PRIMITIVES;
        let mut batches: Vec<(usize, f64)> = Vec::new();
        let (first, first_batch, end) = SLOTS;
        for slot in first..=end {
            let settled = |&(begin, doublings): &(usize, f64)| doublings * (1.0 - 0.2f64.powi((slot - begin) as i32));
            let disturbed = |&(begin, doublings): &(usize, f64)| doublings * 0.2f64.powi((slot - begin) as i32 - 1);
            let gained: f64 = self.of_doubling * batches.iter().map(settled).sum::<f64>();
            let lost: f64 = self.disturbance * batches.iter().map(disturbed).sum::<f64>();
            let level = (self.trend)(slot as f64) + gained - lost;
            let of_view = |view: usize| 20.0 + view as f64 + level + self.noise * normal(&mut rng);
            let psnr: Vec<f64> = (0..self.views).map(of_view).collect();
            if let Some(Finding::Batch(gain)) = growth.end(slot * INTERVAL, &psnr) {
                verdicts.push(gain.verdict);
            }
            if slot == end || growth.next() == Next::Nothing {
                break;
            }
            let grows = slot >= first_batch && growth.next() == Next::Batch;
            let added = if grows { geometric_batch_size(budget, primitives, batches_within(end - slot)) } else { 0 };
            growth.begin(slot * INTERVAL, psnr, primitives, added);
            if added > 0 {
                batches.push((slot, (added as f64 / primitives as f64).ln_1p() / LN_2));
                primitives += added;
            }
        }
        Outcome { verdicts, primitives, growth }
    }

    fn without_noise(trend: fn(f64) -> f64, of_doubling: f64) -> Outcome {
        Self { trend, of_doubling, disturbance: 0.0, noise: 0.0, views: 4 }.run(0)
    }
}

/// Ways in which training alone improves a scene: steadily, slower and slower, and towards a limit.
const TRENDS: [fn(f64) -> f64; 4] = [
    |intervals| 0.3 * intervals,
    |intervals| 2.0 * intervals.ln(),
    |intervals| 5.0 * (1.0 - (-intervals / 4.0).exp()),
    |intervals| 5.0 * (1.0 - (-intervals / 2.0).exp()),
];

#[test]
fn what_training_gains_alone_is_not_the_gain_of_a_batch() {
    for trend in TRENDS {
        let Outcome { verdicts, primitives, growth } = Course::without_noise(trend, -1e-6);
        assert_eq!(verdicts, [Verdict::Settles, Verdict::AwaitsControl, Verdict::Stops]);
        assert_eq!((primitives, growth.next()), (AFTER_ONE, Next::Nothing));
    }
}

#[test]
fn a_scene_that_batches_improve_grows_to_its_limit() {
    for trend in TRENDS {
        for of_doubling in [0.5, 1.0, 3.0] {
            let Outcome { verdicts, primitives, .. } = Course::without_noise(trend, of_doubling);
            assert!(!verdicts.contains(&Verdict::Stops), "{verdicts:?}");
            assert_eq!(primitives, PRIMITIVES.1, "{verdicts:?}");
        }
    }
}

#[test]
fn what_a_batch_disturbs_at_first_is_not_held_against_it() {
    for trend in TRENDS {
        let of = |of_doubling| Course { trend, of_doubling, disturbance: 1.0, noise: 0.0, views: 4 }.run(0);
        let Outcome { verdicts, primitives, .. } = of(1.0);
        assert!(primitives > 2 * AFTER_ONE, "{primitives}: {verdicts:?}");
        assert_eq!(of(0.0).primitives, AFTER_ONE);
    }
}

#[test]
fn clear_batches_follow_one_another_and_others_have_a_control() {
    let steady = Course::without_noise(TRENDS[0], 1.0).verdicts;
    assert!(steady.len() > 5 && steady.iter().all(|&verdict| verdict == Verdict::GoesOn), "{steady:?}");
    let slowing = Course::without_noise(TRENDS[1], 1.0).verdicts;
    assert!(slowing.contains(&Verdict::AwaitsControl), "{slowing:?}");
}

#[test]
fn a_batch_that_makes_views_worse_ends_growth() {
    assert_eq!(Course::without_noise(TRENDS[1], -1.0).primitives, AFTER_ONE);
}

#[test]
fn noise_does_not_turn_decisions_around() {
    let seeds = 0..40;
    let of = |of_doubling: f64| {
        let course = Course { trend: TRENDS[1], of_doubling, disturbance: 0.0, noise: 0.03, views: 12 };
        seeds.clone().map(|seed| course.run(seed).primitives).collect::<Vec<_>>()
    };
    let improved = of(2.0);
    assert!(improved.iter().all(|&primitives| primitives == PRIMITIVES.1), "{improved:?}");
    let idle = of(0.0);
    assert!(idle.iter().filter(|&&primitives| primitives > 2000).count() <= 2, "{idle:?}");
}

#[test]
fn one_view_has_no_error_and_two_batches_decide() {
    let of = |of_doubling| Course { trend: TRENDS[0], of_doubling, disturbance: 0.0, noise: 0.0, views: 1 }.run(0);
    let batch = [Verdict::Settles, Verdict::AwaitsControl];
    assert_eq!(of(0.0).verdicts, [&batch[..], &[Verdict::Undecided], &batch, &[Verdict::Stops]].concat());
    assert_eq!(of(1.0).verdicts[..6], [&batch[..], &[Verdict::Undecided], &batch, &[Verdict::GoesOn]].concat());
}

fn interval(begin: usize, end: usize, rises: [f64; 2]) -> Interval {
    Interval { begin, end, rises: rises.to_vec() }
}

#[track_caller]
fn assert_close(found: &[f64], expected: &[f64]) {
    assert_eq!(found.len(), expected.len());
    assert!(found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-9), "{found:?}, expected {expected:?}");
}

#[test]
fn the_rate_without_a_batch_is_that_between_its_controls() {
    let before = interval(0, 100, [1.0, 2.0]);
    let batch = interval(100, 300, [9.0, 9.0]);
    assert_close(&batch.rises_without(&before, None), &[2.0, 4.0]);
    // a trend that goes faster is linear: half way to three times the rate
    assert_close(&batch.rises_without(&before, Some(&interval(300, 400, [3.0, 6.0]))), &[4.0, 8.0]);
    // one that slows down is exponential: half way to a quarter of the rate would be half of it, but the ratio is limited to
    // a third, where the mean, 2/3, is bent to its root
    let bend = (1.0f64 / 3.0).sqrt() / (2.0 / 3.0);
    let expected = [2.0 * 0.625 * bend, 4.0 * 0.625 * bend];
    assert_close(&batch.rises_without(&before, Some(&interval(300, 400, [0.25, 0.5]))), &expected);
    let later = interval(300, 400, [0.49, 0.98]);
    assert_close(&batch.rises_without(&before, Some(&later)), &[2.0 * 0.7, 4.0 * 0.7]);
    // training that goes faster after a batch fluctuates by half of the difference
    assert_close(&[batch.trend_error(&before, &interval(300, 400, [3.0, 6.0]))], &[3.0]);
    assert_close(&[batch.trend_error(&before, &later)], &[0.0]);
    // two thirds of the way
    let second = interval(200, 300, [9.0, 9.0]);
    let last = interval(300, 400, [4.0, 8.0]);
    assert_close(&second.rises_without(&before, Some(&last)), &[3.0, 6.0]);
}

#[test]
fn gains_of_several_batches_are_pooled_by_view() {
    let excess = |views: &[f64], doublings| Excess { views: views.to_vec(), doublings, trend_error: 0.0 };
    let [first, second] = [excess(&[0.1, 0.3], 0.5), excess(&[0.3, 0.3], 1.5)];
    let Mean { value, error } = Excess::gain(&[first.clone(), second.clone()]);
    assert_close(&[value, error.unwrap()], &[0.25, 0.05]);
    let fluctuating = [Excess { trend_error: 0.24, ..first }, second];
    assert_close(&[Excess::gain(&fluctuating).error.unwrap()], &[0.13]);
    let alone = Excess::gain(&[excess(&[0.25], 0.5)]);
    assert_eq!(alone, Mean { value: 0.5, error: None });
    assert!(!alone.is_clearly_above(0.0) && !alone.is_clearly_below(9.0));
}

#[test]
fn what_cannot_be_measured_is_measured_again() {
    let mut growth = Growth::default();
    assert_eq!(growth.end(100, &[20.0]), None);
    growth.begin(100, vec![20.0, 21.0], 50, 0);
    assert_eq!(growth.end(200, &[f64::NAN, 21.0]), None);
    assert_eq!((growth.next(), growth.is_running()), (Next::Control, false));
    growth.begin(200, vec![20.0, 21.0], 50, 0);
    let found = growth.end(300, &[20.5, 21.5]);
    assert_eq!(found, Some(Finding::Control { rise: 0.5, steps: 100 }));
    assert_eq!(growth.next(), Next::Batch);
    growth.begin(300, vec![20.5, 21.5], 50, 25);
    assert_eq!(growth.end(400, &[f64::INFINITY, 21.0]), None);
    assert_eq!(growth.next(), Next::Control);
}

#[test]
fn what_has_ended_does_not_begin_again() {
    let mut growth = Course::without_noise(TRENDS[0], 0.0).growth;
    assert_eq!(growth, {
        let mut ended = Growth::default();
        ended.finish();
        ended
    });
    growth.begin(9000, vec![20.0], 100, 100);
    assert!(!growth.is_running());
    let again: Growth = serde_json::from_str(&serde_json::to_string(&growth).unwrap()).unwrap();
    assert_eq!(again, growth);
}

#[test]
fn a_history_goes_on_where_it_was_saved() {
    let psnr = |step: usize| (0..3).map(|view| 20.0 + (step as f64).ln() / 3.0 + f64::from(view)).collect::<Vec<_>>();
    let advance = |growth: &mut Growth, step: usize| {
        let found = growth.end(step, &psnr(step));
        let added = if growth.next() == Next::Batch { 70 } else { 0 };
        growth.begin(step, psnr(step), 100, added);
        found
    };
    let mut whole = Growth::default();
    for step in [200, 300, 400, 500, 600] {
        let mut saved: Growth = serde_json::from_str(&serde_json::to_string(&whole).unwrap()).unwrap();
        assert_eq!(advance(&mut saved, step), advance(&mut whole, step));
        assert_eq!(saved, whole);
    }
    let earlier: Growth = serde_json::from_str(r#"{"points": [[100, 20.5]]}"#).unwrap();
    assert_eq!(earlier, Growth::default());
}

#[test]
fn findings_say_what_was_decided_and_why() {
    let mut growth = Growth::default();
    let mut told = Vec::new();
    // the views rise by 0.1 dB in every interval, and by 0.03 dB more with a batch of as many primitives as there were
    for (step, rise, added) in [(0, 0.0, 0), (200, 0.1, 100), (400, 0.23, 0), (600, 0.33, 0)] {
        let psnr = vec![20.0 + rise, 25.0 + rise];
        told.extend(growth.end(step, &psnr).map(|found| found.to_string()));
        growth.begin(step, psnr, 100, added);
    }
    told.extend(growth.end(800, &[20.43, 25.43]).map(|found| found.to_string()));
    let [control, batch, settled, judged] = &told[..] else { panic!("{told:?}") };
    assert_eq!(control, "validation error -2.3 % in 200 steps without new Gaussians: +0.100 dB");
    for part in [
        "batch of 100 Gaussians: validation error -2.9 % in 200 steps, -2.3 % without one: +0.030 dB",
        "time to settle",
    ] {
        assert!(batch.contains(part), "{batch}");
    }
    for part in ["validation error -5.2 % in 400 steps, -4.5 % without one: +0.030 dB", "an interval without a batch"] {
        assert!(settled.contains(part), "{settled}");
    }
    assert!(
        judged.ends_with("+0.030 ± 0.000 dB for twice the primitives, at least 0.05 wanted: growth stops"),
        "{judged}"
    );
}
