//! At which steps of a stage of blended Gaussians the set of Gaussians changes.

use crate::config::stages::SHORTEST_RESET;
use crate::config::{Config, Relocation, StagePlan};

/// Fewest steps between two relocations: fewer would say nothing new about who is dead, and cost more than the steps.
const SHORTEST_RELOCATION: usize = 5;

/// Completed steps of a stage at which something changes, ascending.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct BlendedSchedule {
    pub densify: Vec<usize>,
    /// When opacities are reset.
    pub reset: Vec<usize>,
    pub relocate: Vec<usize>,
}

/// What is due after a given number of completed steps.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct BlendedDue {
    pub densify: bool,
    pub reset: bool,
    pub relocate: bool,
}

impl BlendedSchedule {
    /// The schedule of a stage over `views` training views, of Gaussians that are relocated or, without `relocation`, of
    /// discs. Densification waits until all views were seen, as pruning does.
    pub fn new(config: &Config, plan: StagePlan, relocation: Option<Relocation>, views: usize) -> Self {
        let scaled = |steps: Vec<usize>| -> Vec<usize> {
            let mut steps: Vec<usize> = steps.into_iter().map(|step| plan.scaled(step)).collect();
            steps.retain(|&step| step > 0 && step < plan.steps);
            steps.dedup();
            steps
        };
        let every = |every: usize, from: usize, until: usize| (from..until).step_by(every.max(1)).collect::<Vec<_>>();
        match relocation {
            None => {
                let discs = &config.discs;
                let views = views.max(1);
                let until = plan.scaled(discs.densify_until).min(plan.steps);
                let steps = every(discs.densify_every, discs.densify_from + discs.densify_every, discs.densify_until);
                let mut densify: Vec<usize> =
                    scaled(steps).into_iter().map(|step| step.div_ceil(views) * views).collect();
                densify.retain(|&step| step < until);
                densify.dedup();
                let resets = plan.scaled(discs.reset_every) >= SHORTEST_RESET;
                let reset = if resets {
                    scaled(every(discs.reset_every, discs.reset_every, discs.densify_until))
                } else {
                    Vec::new()
                };
                Self { densify, reset, relocate: Vec::new() }
            }
            Some(_) => {
                let relocation = &config.relocation;
                let steps = every(relocation.every, relocation.from + relocation.every, relocation.until);
                let mut relocate = scaled(steps);
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

    pub fn due(&self, completed: usize) -> BlendedDue {
        let due = |steps: &[usize]| steps.binary_search(&completed).is_ok();
        BlendedDue { densify: due(&self.densify), reset: due(&self.reset), relocate: due(&self.relocate) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::{Method, StageKind};

    fn schedule(method: Method, steps: usize, views: usize) -> BlendedSchedule {
        let mut config = Config::default();
        (config.train.method, config.train.steps) = (method, steps);
        let plan = config.plan()[0];
        let relocation = if let StageKind::Gaussians(relocation) = plan.kind { Some(relocation) } else { None };
        BlendedSchedule::new(&config, plan, relocation, views)
    }

    #[test]
    fn methods_of_their_own_length_have_the_schedules_of_their_papers() {
        let discs = schedule(Method::Discs, 30_000, 100);
        assert_eq!((discs.densify[0], discs.densify.last(), discs.densify.len()), (600, Some(&14_900), 144));
        assert_eq!(discs.reset, [3000, 6000, 9000, 12_000]);
        let dbs = schedule(Method::Dbs, 30_000, 100);
        assert_eq!((dbs.relocate[0], dbs.relocate.last(), dbs.relocate.len()), (600, Some(&24_900), 244));
        assert!(dbs.densify.is_empty() && discs.relocate.is_empty());
    }

    #[test]
    fn short_runs_wait_for_every_view_and_reset_nothing() {
        let discs = schedule(Method::Discs, 3000, 40);
        assert!(discs.densify.iter().all(|step| step % 40 == 0) && discs.densify.len() > 20);
        assert!(discs.reset.is_empty());
        let mcmc = schedule(Method::Mcmc, 300, 40);
        assert!(mcmc.relocate.windows(2).all(|pair| pair[0] + 5 <= pair[1]) && mcmc.relocate.len() > 40);
        assert!(mcmc.relocate.iter().all(|&step| step < 250));
    }
}
