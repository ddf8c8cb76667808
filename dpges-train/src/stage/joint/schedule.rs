//! The steps of the joint stage at which the set of primitives changes.

use crate::config::stages::REFERENCE_STEPS;
use crate::config::{Budget, Config, NewGaussians};

/// Numbers of completed steps of the stage, ascending: a change due at 1000 happens after the 1000th step, margins due
/// at 0 are computed before the first. Nothing is due after the last step.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Schedule {
    pub margins: Vec<usize>,
    pub surfel_prune: Vec<usize>,
    pub gaussian_prune: Vec<usize>,
    pub add: Vec<usize>,
    /// Replacements of Gaussians that are not drawn, after the last batch of new ones.
    pub replace: Vec<usize>,
    /// Whether new Gaussians are copies.
    pub copies: bool,
    pub split: Vec<usize>,
    /// Empty unless the budget is automatic.
    pub drop_lobes: Vec<usize>,
}

/// The changes that are due after a given number of completed steps.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Due {
    pub margins: bool,
    pub surfel_prune: bool,
    pub gaussian_prune: bool,
    /// Batches of Gaussians still to add, including one now; `None` if none is due now.
    pub batches_left: Option<usize>,
    /// Whether Gaussians that are not drawn are replaced by new ones.
    pub replace: bool,
    pub split: bool,
    pub drop_lobes: bool,
}

/// Steps at which an automatic budget drops lobes that change no colour visibly.
const DROP_LOBES_AT: [usize; 2] = [16_000, 22_000];

impl Schedule {
    /// The schedule of a joint stage of `length` steps over `views` training views, each of which is drawn once per `views` steps.
    ///
    /// Pruning is postponed to the end of the pass over the views, so that its statistics cover every view. Prunings
    /// that then coincide become one, and none happens if the run or its `_until` ends before the first pass. Frozen
    /// surfels are not pruned.
    pub fn new(config: &Config, length: usize, views: usize) -> Self {
        let refine = &config.refine;
        let scale = length as f64 / REFERENCE_STEPS as f64;
        let scaled = |step: usize| (step as f64 * scale).round() as usize;
        let run = |steps: Vec<usize>, first: usize| {
            let mut steps: Vec<usize> = steps.into_iter().map(scaled).collect();
            steps.retain(|&step| (first..length).contains(&step));
            steps.sort_unstable();
            steps.dedup();
            steps
        };
        // a surfel that a missing view would have seen must not be pruned for it
        let whole_passes = |steps: Vec<usize>, until: usize| {
            let views = views.max(1);
            let mut steps: Vec<usize> = steps.into_iter().map(|step| step.div_ceil(views) * views).collect();
            steps.retain(|&step| step < until.min(length));
            steps.dedup();
            steps
        };
        // what is due later lies beyond the run, however far that is
        let every = |every: usize, from: usize, until: usize| {
            (from..until.min(REFERENCE_STEPS)).step_by(every.max(1)).collect::<Vec<_>>()
        };
        let only_if = |wanted: bool, steps: Vec<usize>| if wanted { steps } else { Vec::new() };

        let surfel_prune =
            every(refine.surfel_prune_every, refine.surfel_prune_from, refine.surfel_prune_until.saturating_add(1));
        let surfel_prune = only_if(!config.train.freeze_surfels, surfel_prune);
        let gaussian_prune =
            every(refine.gaussian_prune_every, refine.gaussian_prune_every, refine.gaussian_prune_until);
        let split = every(refine.split_every, refine.split_every, refine.split_until.saturating_add(1));
        let automatic = refine.budget == Budget::Auto;
        Self {
            // before the first step, too; everything else needs what steps have observed
            margins: run(refine.margins_at.clone(), 0),
            surfel_prune: whole_passes(run(surfel_prune, 1), scaled(refine.surfel_prune_until).saturating_add(1)),
            gaussian_prune: whole_passes(run(gaussian_prune, 1), scaled(refine.gaussian_prune_until)),
            add: run(every(refine.add_every, refine.add_from, refine.add_until), 1),
            replace: run(every(refine.add_every, refine.add_until, refine.replace_until), 1),
            copies: refine.new_gaussians == NewGaussians::Copies,
            split: run(split, 1),
            drop_lobes: run(only_if(automatic, DROP_LOBES_AT.to_vec()), 1),
        }
    }

    /// The number of completed steps, more than `completed_steps`, at which Gaussians are copied next; `None` if none are.
    pub fn next_copies(&self, completed_steps: usize) -> Option<usize> {
        // what is due now has been done
        let after = |steps: &[usize]| steps.get(steps.partition_point(|&step| step <= completed_steps)).copied();
        let next = [after(&self.add), after(&self.replace)].into_iter().flatten().min();
        next.filter(|_| self.copies)
    }

    pub fn due(&self, completed_steps: usize) -> Due {
        let is_in = |steps: &[usize]| steps.binary_search(&completed_steps);
        Due {
            margins: is_in(&self.margins).is_ok(),
            surfel_prune: is_in(&self.surfel_prune).is_ok(),
            gaussian_prune: is_in(&self.gaussian_prune).is_ok(),
            batches_left: is_in(&self.add).ok().map(|batch| self.add.len() - batch),
            replace: is_in(&self.replace).is_ok(),
            split: is_in(&self.split).is_ok(),
            drop_lobes: is_in(&self.drop_lobes).is_ok(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A run of the joint stage alone.
    fn config(steps: usize) -> Config {
        let mut config = Config::default();
        (config.train.steps, config.stages.gaussians) = (steps, 0.0);
        config
    }

    #[test]
    fn the_reference_run_has_the_schedule_of_the_paper() {
        let schedule = Schedule::new(&config(REFERENCE_STEPS), REFERENCE_STEPS, 100);
        assert_eq!(schedule.margins, [0, 4000]);
        assert_eq!(schedule.surfel_prune, (1..=15).map(|n| n * 1000).collect::<Vec<_>>());
        assert!(schedule.gaussian_prune.is_empty());
        assert_eq!(schedule.add, (3..13).map(|n| n * 1000).collect::<Vec<_>>());
        assert_eq!(schedule.replace, (13..20).map(|n| n * 1000).collect::<Vec<_>>());
        assert_eq!(schedule.split, (1..=8).map(|n| n * 2000).collect::<Vec<_>>());
        let due = schedule.due(12_000);
        assert_eq!(due, Due { surfel_prune: true, batches_left: Some(1), split: true, ..Due::default() });
        assert_eq!(schedule.due(3000).batches_left, Some(10));
        assert!(schedule.due(0).margins);
        assert_eq!(
            [0, 3000, 12_999, 19_000].map(|completed| schedule.next_copies(completed)),
            [Some(3000), Some(4000), Some(13_000), None]
        );
        assert_eq!(schedule.due(3001), Due::default());
    }

    #[test]
    fn shorter_runs_scale_it() {
        let schedule = Schedule::new(&config(5000), 5000, 50);
        assert_eq!(schedule.margins, [0, 800]);
        assert_eq!(schedule.surfel_prune[..3], [200, 400, 600]);
        assert_eq!(schedule.surfel_prune.last(), Some(&3000));
        assert_eq!((schedule.add[0], schedule.add.len()), (600, 10));
    }

    #[test]
    fn switches_take_their_changes_out_and_no_others() {
        let all = Schedule::new(&config(REFERENCE_STEPS), REFERENCE_STEPS, 100);
        let mut frozen = config(REFERENCE_STEPS);
        frozen.train.freeze_surfels = true;
        assert_eq!(Schedule::new(&frozen, REFERENCE_STEPS, 100), Schedule { surfel_prune: vec![], ..all.clone() });
        let mut automatic = config(REFERENCE_STEPS);
        automatic.refine.budget = Budget::Auto;
        let dropping = Schedule { drop_lobes: vec![16_000, 22_000], ..all.clone() };
        assert_eq!(Schedule::new(&automatic, REFERENCE_STEPS, 100), dropping);
        let mut unsplit = config(REFERENCE_STEPS);
        unsplit.refine.split_until = 0;
        assert_eq!(Schedule::new(&unsplit, REFERENCE_STEPS, 100), Schedule { split: vec![], ..all });
    }

    #[test]
    fn changes_without_an_end_go_on_to_the_last_step() {
        let ending_at = |until: usize| {
            let mut config = config(REFERENCE_STEPS);
            let refine = &mut config.refine;
            (refine.surfel_prune_until, refine.gaussian_prune_until, refine.split_until) = (until, until, until);
            (refine.add_until, refine.margins_at) = (until, vec![0, until]);
            let growing = Schedule::new(&config, REFERENCE_STEPS, 100);
            (config.refine.add_until, config.refine.replace_until) = (4000, until);
            [growing, Schedule::new(&config, REFERENCE_STEPS, 100)]
        };
        let [growing, replacing] = ending_at(REFERENCE_STEPS);
        assert_eq!((growing.add.last(), growing.split.last()), (Some(&24_000), Some(&24_000)));
        assert_eq!((growing.surfel_prune.last(), replacing.replace.last()), (Some(&24_000), Some(&24_000)));
        for until in [1_000_000_000_000, i64::MAX as usize, usize::MAX] {
            assert_eq!(ending_at(until), [growing.clone(), replacing.clone()], "{until}");
        }
    }

    #[test]
    fn every_window_of_pruning_sees_every_view() {
        let mut config = config(5000);
        config.refine.gaussian_prune_until = 2000;
        for views in [1, 7, 130, 311] {
            let schedule = Schedule::new(&config, 5000, views);
            for steps in [&schedule.surfel_prune, &schedule.gaussian_prune] {
                assert!(!steps.is_empty());
                assert!(steps.iter().all(|step| step % views == 0), "{views}: {steps:?}");
                assert!(steps.windows(2).all(|pair| pair[0] < pair[1]));
            }
        }
        assert!(Schedule::new(&config, 5000, 401).gaussian_prune.is_empty());
    }

    #[test]
    fn tiny_runs_and_odd_keys_give_ascending_steps_within_the_run() {
        for steps in [1, 2, 7, 40] {
            let schedule = Schedule::new(&config(steps), steps, 3);
            for steps_of in [&schedule.surfel_prune, &schedule.gaussian_prune, &schedule.add, &schedule.split] {
                assert!(steps_of.iter().all(|&step| step > 0 && step < steps));
                assert!(steps_of.windows(2).all(|pair| pair[0] < pair[1]));
            }
            assert_eq!(schedule.margins[0], 0);
        }
        let mut odd = config(1000);
        odd.refine.margins_at = vec![4000, 0, 4000, 90_000];
        odd.refine.add_from = 20_000;
        let schedule = Schedule::new(&odd, 1000, 0);
        assert_eq!(schedule.margins, [0, 160]);
        assert!(schedule.add.is_empty());
    }

    #[test]
    fn ges_has_the_schedule_of_its_paper() {
        let schedule = Schedule::new(&Config::resolve(Some("ges"), None, &[]).unwrap(), 30_000, 1);
        assert!(schedule.surfel_prune.is_empty() && schedule.split.is_empty());
        let near = |found: &[usize], expected: &[usize]| {
            found.len() == expected.len() && found.iter().zip(expected).all(|(a, b)| a.abs_diff(*b) <= 1)
        };
        assert_eq!(schedule.margins, [0]);
        assert!(near(&schedule.gaussian_prune, &[500, 1000, 1500]), "{schedule:?}");
        assert!(near(&schedule.add, &[8000, 9000, 10_000, 11_000, 12_000]), "{schedule:?}");
    }
}
