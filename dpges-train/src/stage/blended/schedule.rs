//! At which steps of a stage of blended primitives their set changes.

use std::iter::StepBy;
use std::ops::Range;

use crate::config::stages::SHORTEST_RESET;
use crate::config::{Blended, Density, StagePlan};

/// Interval of densification and of relocation, and the step after which they begin (3DGS, 2DGS, 3DGS-MCMC).
const EVERY: usize = 100;
const FROM: usize = 500;
/// Step at which densification ends, exclusive (3DGS, 2DGS).
const DENSIFY_UNTIL: usize = 15_000;
/// Step at which relocation ends, exclusive (3DGS-MCMC).
const RELOCATE_UNTIL: usize = 25_000;
/// Steps in which Gaussians are relocated.
pub const RELOCATION: Range<usize> = FROM..RELOCATE_UNTIL;
/// Interval of opacity resets (3DGS). There are none if it is less than [`SHORTEST_RESET`] steps of the run.
const RESET_EVERY: usize = 3000;
/// Fewest steps between two relocations: fewer would say nothing new about who is dead, and cost more than the steps.
const SHORTEST_RELOCATION: usize = 5;
/// Interval of limiting opacities and their limit (AbsGS).
const CAP_EVERY: usize = 500;
pub const CAPPED_OPACITY: f64 = 0.8;
/// Fewest steps between two limitations.
const SHORTEST_CAP: usize = 100;
/// Interval at which opacities decay, and their factor then (HTGS). In shorter runs the interval is as many steps of the run, and
/// the factor that of all intervals it stands for.
const DECAY_EVERY: usize = 50;
const DECAY: f64 = 0.9995;
/// Steps at which Gaussians that no training view needs are removed (HTGS).
const UNNEEDED_AT: [usize; 2] = [16_000, 24_000];

/// One value for every kind of change.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Changes<T> {
    pub densify: T,
    /// Resets of opacities.
    pub reset: T,
    /// Limits to opacities.
    pub cap: T,
    pub relocate: T,
    /// Measurements of the sampling limit, besides whenever Gaussians come or go.
    pub measure: T,
    /// The decay of opacities.
    pub decay: T,
    /// The removal of Gaussians that no training view needs.
    pub prune: T,
}

/// Completed steps of a stage at which something changes, ascending.
pub type BlendedSchedule = Changes<Vec<usize>>;
/// Changes due after a given number of completed steps.
pub type BlendedDue = Changes<bool>;

/// Interval at which opacities decay in a stage, and their factor then.
pub fn decay(plan: StagePlan) -> (usize, f64) {
    let interval = plan.scaled(DECAY_EVERY).max(DECAY_EVERY);
    let share = interval as f64 * plan.reference_steps as f64 / (plan.steps as f64 * DECAY_EVERY as f64);
    (interval, DECAY.powf(share))
}

impl BlendedSchedule {
    /// The schedule of a stage over `views` training views. Densification of discs waits until all views were seen, as
    /// pruning does.
    pub fn new(plan: StagePlan, blended: Blended, views: usize) -> Self {
        let every = |every: usize, from: usize, until: usize| (from..until).step_by(every);
        let scaled = |steps: StepBy<Range<usize>>| -> Vec<usize> {
            let within = steps.map(|step| plan.scaled(step)).take_while(|&step| step < plan.steps);
            let mut steps: Vec<usize> = within.filter(|&step| step > 0).collect();
            steps.dedup();
            steps
        };
        let only_if = |wanted: bool, steps: Vec<usize>| if wanted { steps } else { Vec::new() };
        let resets = scaled(every(RESET_EVERY, RESET_EVERY, DENSIFY_UNTIL));
        let reset = only_if(plan.scaled(RESET_EVERY) >= SHORTEST_RESET, resets);
        match blended {
            Blended::Discs => {
                let views = views.max(1);
                let until = plan.scaled(DENSIFY_UNTIL).min(plan.steps);
                let steps = scaled(every(EVERY, FROM + EVERY, DENSIFY_UNTIL));
                let mut densify: Vec<usize> = steps.into_iter().map(|step| step.div_ceil(views) * views).collect();
                densify.retain(|&step| step < until);
                densify.dedup();
                Self { densify, reset, ..Self::default() }
            }
            Blended::Controlled(density) => {
                let interval = plan.scaled(EVERY).max(EVERY.min(views)).max(1);
                let from = plan.scaled(FROM) + interval;
                let until = plan.scaled(DENSIFY_UNTIL).min(plan.steps);
                let cap = plan.scaled(CAP_EVERY) >= SHORTEST_CAP && density == Density::Absolute;
                let decays = density == Density::Hybrid;
                let (decay, _) = decay(plan);
                Self {
                    densify: every(interval, from, until).collect(),
                    reset: only_if(!decays && density != Density::Summed, reset),
                    cap: only_if(cap, scaled(every(CAP_EVERY, CAP_EVERY, DENSIFY_UNTIL))),
                    measure: only_if(blended.smooths(), every(interval, interval, plan.steps).collect()),
                    decay: only_if(decays, every(decay, plan.scaled(FROM) + decay, until + 1).collect()),
                    prune: only_if(decays, UNNEEDED_AT.map(|step| plan.scaled(step)).to_vec()),
                    ..Self::default()
                }
            }
            Blended::Relocated(_) => {
                let mut relocate = scaled(every(EVERY, RELOCATION.start + EVERY, RELOCATION.end));
                let mut last = 0;
                relocate.retain(|&step| {
                    let stays = step - last >= SHORTEST_RELOCATION;
                    last = if stays { step } else { last };
                    stays
                });
                Self { relocate, ..Self::default() }
            }
        }
    }

    /// The changes due after `completed` steps, the last `views` of which were taken at once.
    pub fn due(&self, completed: usize, views: usize) -> BlendedDue {
        let due = |steps: &[usize]| {
            let next = steps.partition_point(|&step| step + views <= completed);
            steps.get(next).is_some_and(|&step| step <= completed)
        };
        BlendedDue {
            densify: due(&self.densify),
            reset: due(&self.reset),
            cap: due(&self.cap),
            relocate: due(&self.relocate),
            measure: due(&self.measure),
            decay: due(&self.decay),
            prune: due(&self.prune),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::{Config, Method};

    fn schedule(method: Method, steps: usize, views: usize) -> BlendedSchedule {
        let mut config = Config::default();
        (config.train.method, config.train.steps) = (method, steps);
        BlendedSchedule::new(config.plan(0)[0], method.alone().unwrap(), views)
    }

    #[test]
    fn methods_of_their_own_length_have_the_schedules_of_their_papers() {
        let discs = schedule(Method::Discs, 30_000, 100);
        assert_eq!((discs.densify[0], discs.densify.last(), discs.densify.len()), (600, Some(&14_900), 144));
        assert_eq!(discs.reset, [3000, 6000, 9000, 12_000]);
        let plain = schedule(Method::Gaussians3d, 30_000, 300);
        assert_eq!((&plain.densify, &plain.reset), (&discs.densify, &discs.reset));
        assert!(plain.cap.is_empty() && plain.measure.is_empty());
        assert_eq!(schedule(Method::StopThePop, 30_000, 300), plain);
        let absolute = schedule(Method::Absolute, 30_000, 300);
        assert_eq!((absolute.cap[0], absolute.cap.last(), absolute.cap.len()), (500, Some(&14_500), 29));
        let smoothed = schedule(Method::MipSplatting, 30_000, 300);
        assert_eq!((smoothed.measure[0], smoothed.measure.last()), (100, Some(&29_900)));
        let hybrid = schedule(Method::Htgs, 30_000, 300);
        assert_eq!((&hybrid.densify, &hybrid.measure), (&smoothed.densify, &smoothed.measure));
        assert_eq!((hybrid.decay[0], hybrid.decay.last(), hybrid.decay.len()), (550, Some(&15_000), 290));
        assert_eq!((hybrid.prune, hybrid.reset), (vec![16_000, 24_000], vec![]));
        let summed = schedule(Method::SortFree, 30_000, 300);
        assert_eq!(summed, BlendedSchedule { densify: plain.densify, ..BlendedSchedule::default() });
        let dbs = schedule(Method::Dbs, 30_000, 100);
        assert_eq!((dbs.relocate[0], dbs.relocate.last(), dbs.relocate.len()), (600, Some(&24_900), 244));
        assert!(dbs.densify.is_empty() && discs.relocate.is_empty());
        assert_eq!(schedule(Method::Sss, 30_000, 100), dbs);
    }

    #[test]
    fn what_is_due_within_a_batch_is_due_once_after_it() {
        let schedule = BlendedSchedule { relocate: vec![3, 4, 9], reset: vec![6], ..BlendedSchedule::default() };
        let due = |views: usize| -> Vec<usize> {
            (0..=12).step_by(views).filter(|&completed| schedule.due(completed, views).relocate).collect()
        };
        assert_eq!([due(1), due(2), due(3)], [vec![3, 4, 9], vec![4, 10], vec![3, 6, 9]]);
        assert!(schedule.due(6, 3).reset && !schedule.due(9, 3).reset && !schedule.due(0, 4).reset);
    }

    #[test]
    fn short_runs_wait_for_every_view_and_reset_nothing() {
        let discs = schedule(Method::Discs, 3000, 40);
        assert!(discs.densify.iter().all(|step| step % 40 == 0) && discs.densify.len() > 20);
        assert!(discs.reset.is_empty());
        let mcmc = schedule(Method::Mcmc, 300, 40);
        assert!(mcmc.relocate.windows(2).all(|pair| pair[0] + 5 <= pair[1]) && mcmc.relocate.len() > 40);
        assert!(mcmc.relocate.iter().all(|&step| step < 250));
        let plain = schedule(Method::Gaussians3d, 2000, 112);
        assert_eq!((plain.densify[0], plain.densify[1], plain.densify.len()), (133, 233, 9));
        assert!(plain.reset.is_empty());
    }
}
