//! The number of steps that fits into a length of time.

use std::sync::Arc;
use std::time::{Duration, Instant};

use burn::tensor::Device;

use super::{TargetError, TargetPlan, Unit};
use crate::config::Config;
use crate::dataset::{BuiltinOptions, Dataset, builtin};
use crate::eval::evaluate;
use crate::run::{TrainError, Trainer};

/// Steps that say how long a rehearsal may be; the first compiles kernels and is not counted.
const FIRST_STEPS: usize = 6;
/// Share of the time that a rehearsal takes, and its length in steps.
const REHEARSAL: f64 = 0.05;
const REHEARSAL_STEPS: [usize; 2] = [30, 300];
/// Steps on the built-in scene, and its sides, px.
const BUILTIN_STEPS: usize = 20;
const BUILTIN_SIDES: [usize; 2] = [64, 128];
/// A run needs so many steps to be one.
const FEWEST_STEPS: f64 = 20.0;
/// No run is longer, whatever the time.
const MOST_STEPS: f64 = 1e9;

/// The times of a run, s.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Costs {
    /// A step in which nothing else happens.
    step: f64,
    /// All refinements together, of which there are as many in a short run as in a long one.
    refinement: f64,
    evaluation: f64,
}

impl Costs {
    /// The run of `config` up to its last step.
    fn of(&self, config: &Config) -> f64 {
        let (steps, every) = (config.train.steps, config.train.evaluate_every);
        let evaluations = steps.saturating_sub(1).checked_div(every).unwrap_or(0);
        self.refinement + steps as f64 * self.step + evaluations as f64 * self.evaluation
    }

    /// The largest number of steps whose run takes at most `seconds`, the evaluation at the end included.
    fn steps_within(&self, seconds: f64, config: &Config) -> f64 {
        let every = config.train.evaluate_every;
        let of_evaluations = if every > 0 { self.evaluation / every as f64 } else { 0.0 };
        ((seconds - self.refinement - self.evaluation) / (self.step + of_evaluations)).floor()
    }
}

/// Sets `train.steps` to what fits into `asked`, less what is measured here: a rehearsal of the whole run, with few steps.
/// Schedules scale with the steps, so that it goes through every stage and grows to the same budget.
pub(super) fn plan(
    asked: String,
    config: &mut Config,
    dataset: &Arc<Dataset>,
    device: &Device,
    length: Duration,
) -> Result<TargetPlan, TargetError> {
    let begun = Instant::now();
    let mut first = Trainer::new(config.clone(), Arc::clone(dataset), device.clone())?;
    let times = timed(&mut first, FIRST_STEPS)?;
    drop(first);
    let step = mean(times.iter().skip(1).map(|(seconds, _)| *seconds)).unwrap_or(0.0);
    let [least, most] = REHEARSAL_STEPS;
    let steps = (REHEARSAL * length.as_secs_f64() / step.max(1e-9)) as usize;
    let mut rehearsal = config.clone();
    rehearsal.train.steps = steps.clamp(least, most);
    let costs = rehearse(rehearsal, dataset, device)?;
    let Costs { step, refinement, evaluation } = costs;
    let spent = begun.elapsed().as_secs_f64();
    let steps = costs.steps_within(length.as_secs_f64() - spent, config);
    if steps.is_nan() || steps < FEWEST_STEPS {
        let measured = format!(
            "measuring takes {spent:.1} s, refinement {refinement:.1} s, an evaluation {evaluation:.1} s and a step {:.0} ms",
            1e3 * step
        );
        let least = (spent + refinement + 2.0 * evaluation + 2.0 * FEWEST_STEPS * step).ceil();
        return Err(TargetError::TooShort { asked: length.as_secs_f64(), measured, least });
    }
    config.train.steps = steps.min(MOST_STEPS) as usize;
    let how = format!("{} steps of {:.1} ms, {refinement:.1} s of refinement", config.train.steps, 1e3 * step);
    Ok(TargetPlan { asked, unit: Unit::Seconds, expected: costs.of(config), how, cameras: Vec::new() })
}

/// How long steps last on a device, by the built-in scene in two sizes: a time of their own and one per pixel, since budgets
/// grow with pixels.
pub struct StepTimes {
    /// Pixels and seconds of a step of each.
    measured: [(f64, f64); 2],
}

impl StepTimes {
    /// Measures steps of `config`, for some seconds.
    ///
    /// # Errors
    /// [`TargetError::Train`].
    pub fn of_builtin(config: &Config, device: &Device) -> Result<Self, TargetError> {
        let mut rehearsal = config.clone();
        (rehearsal.train.steps, rehearsal.train.evaluate_every) = (BUILTIN_STEPS, 0);
        // the joint stage alone, whose steps are most of a run's
        (rehearsal.stages.gaussians, rehearsal.stages.coarse) = (0.0, 0.0);
        let step_of = |side: usize| {
            let options = BuiltinOptions { width: side, height: side, test_views: 0, ..BuiltinOptions::default() };
            let costs = rehearse(rehearsal.clone(), &Arc::new(builtin(&options)), device)?;
            Ok::<_, TargetError>(((side * side) as f64, costs.step))
        };
        let [small, large] = BUILTIN_SIDES;
        let measure = || Ok(Self { measured: [step_of(small)?, step_of(large)?] });
        // what it says is not of the dataset
        tracing::subscriber::with_default(tracing::subscriber::NoSubscriber::new(), measure)
    }

    /// Seconds of a step on a view of `pixels`.
    pub fn step(&self, pixels: usize) -> f64 {
        let [(few, of_few), (many, of_many)] = self.measured;
        let per_pixel = ((of_many - of_few) / (many - few)).max(0.0);
        (of_few + per_pixel * (pixels as f64 - few)).max(0.5 * of_few)
    }
}

fn rehearse(config: Config, dataset: &Arc<Dataset>, device: &Device) -> Result<Costs, TargetError> {
    let steps = config.total_steps();
    let mut trainer = Trainer::new(config, Arc::clone(dataset), device.clone())?;
    let times = timed(&mut trainer, steps)?;
    let seconds =
        |busy: bool| times.iter().skip(1).filter(move |(_, is_busy)| *is_busy == busy).map(|(seconds, _)| *seconds);
    let step = mean(seconds(false)).or_else(|| mean(seconds(true))).unwrap_or(0.0);
    let refinement = seconds(true).map(|seconds| (seconds - step).max(0.0)).sum();
    let start = Instant::now();
    if !dataset.test.is_empty() {
        evaluate(&trainer.scene(), &dataset.test, device)?;
    }
    Ok(Costs { step, refinement, evaluation: start.elapsed().as_secs_f64() })
}

/// Takes at most `steps`: the time of each, and whether anything else than a step happened.
fn timed(trainer: &mut Trainer, steps: usize) -> Result<Vec<(f64, bool)>, TrainError> {
    let mut times = Vec::with_capacity(steps);
    while times.len() < steps && !trainer.is_finished() {
        let (start, stage) = (Instant::now(), trainer.stage().kind);
        let known = trainer.step()?;
        let begins_stage = trainer.stage().kind != stage;
        let report = trainer.settle()?.or(known);
        let seconds = start.elapsed().as_secs_f64();
        let has_events = report.is_some_and(|report| !report.events.is_empty());
        times.push((seconds, begins_stage || has_events));
    }
    Ok(times)
}

fn mean(values: impl Iterator<Item = f64>) -> Option<f64> {
    let (sum, count) = values.fold((0.0, 0usize), |(sum, count), value| (sum + value, count + 1));
    (count > 0).then(|| sum / count as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steps_last_longer_on_larger_views() {
        let times = StepTimes { measured: [(1000.0, 0.02), (3000.0, 0.03)] };
        assert!((times.step(2000) - 0.025).abs() < 1e-12 && (times.step(11_000) - 0.07).abs() < 1e-12);
        // noise does not make large views faster than small ones
        assert_eq!(StepTimes { measured: [(1000.0, 0.02), (3000.0, 0.01)] }.step(1_000_000), 0.02);
    }

    #[test]
    fn steps_fill_the_time() {
        let mut config = Config::default();
        config.train.evaluate_every = 100;
        let costs = Costs { step: 0.1, refinement: 20.0, evaluation: 5.0 };
        // 20 s, 5 s at the end, and 0.15 s per step
        let steps = costs.steps_within(325.0, &config);
        assert!((steps - 2000.0).abs() <= 1.0, "{steps}");
        config.train.steps = 2000;
        assert!((costs.of(&config) - (20.0 + 200.0 + 19.0 * 5.0)).abs() < 1e-9);
        config.train.evaluate_every = 0;
        assert_eq!(costs.steps_within(325.0, &config), 3000.0);
        assert!((costs.of(&config) - 220.0).abs() < 1e-9);
        assert!(costs.steps_within(24.0, &config) < FEWEST_STEPS);
    }
}
