//! What is trained before surfels and Gaussians are optimised together, or instead (DP-GES, initialisation).

use std::fmt;

use serde::{Deserialize, Serialize};

use super::Config;
use super::schedule::REFERENCE_STEPS;

/// What a run trains.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Method {
    /// Surfels and Gaussians, after the stages that `[stages]` asks for (DP-GES).
    #[default]
    Dpges,
    /// Flat Gaussians blended in the order of their depths (2DGS).
    #[serde(rename = "2dgs")]
    Discs,
    /// Gaussians blended in the order of their depths, relocated and jittered at every step (3DGS-MCMC).
    Mcmc,
    /// The same, relocated and jittered together (DBS, with a Gaussian kernel).
    Dbs,
}

/// Where the Gaussians of the joint stage come from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum GaussianStage {
    /// A training by DBS (DP-GES).
    #[default]
    Dbs,
    /// A training by 3DGS-MCMC.
    Mcmc,
    /// The discs that were not opaque enough for surfels (GES).
    Rest,
}

/// The stages before the joint one.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct StagesConfig {
    /// Share of `train.steps` for the discs that become surfels; 0: surfels start as `[init]` says. DP-GES: 20/65.
    pub surfels: f64,
    /// Share of `train.steps` for the Gaussians; 0: they start as `[init]` says. DP-GES: 20/65. Without effect where
    /// they are the rest of the discs.
    pub gaussians: f64,
    pub gaussians_by: GaussianStage,
    /// Scene file whose discs or surfels are taken instead of a stage; empty: none.
    pub surfels_from: String,
    /// Scene file whose Gaussians are taken instead of a stage; empty: none.
    pub gaussians_from: String,
    /// Discs more opaque than this become surfels (GES, DP-GES).
    pub surfel_opacity: f64,
    /// Scale of a surfel over that of its disc. DP-GES: 1; but a disc is half opaque at 1.2 σ, and a surfel of w = 30 at
    /// 2.9 σ, so that it covers as much at 0.4.
    pub surfel_scale: f64,
    /// Share of `refine.budget` that discs may fill.
    pub surfel_budget: f64,
    /// Share of `refine.budget` that Gaussians may fill before the joint stage (DP-GES: 50 to 60 %).
    pub gaussian_budget: f64,
    /// Learning rate of the logit of opacities in these stages (3DGS).
    pub opacities: f64,
    /// Share of the schedule of `optimizer.position_start` and `_end` that these stages go through, and at which the
    /// joint stage begins (DP-GES: 20,000 of 30,000 steps).
    pub position_share: f64,
}

impl Default for StagesConfig {
    fn default() -> Self {
        Self {
            surfels: 0.0,
            gaussians: 0.0,
            gaussians_by: GaussianStage::Dbs,
            surfels_from: String::new(),
            gaussians_from: String::new(),
            surfel_opacity: 0.8,
            surfel_scale: 0.35,
            surfel_budget: 0.3,
            gaussian_budget: 0.6,
            opacities: 0.05,
            position_share: 0.0,
        }
    }
}

/// Training of discs (2DGS). Keys that end in `_every`, `_from` and `_until` are in steps of a stage of
/// [`STAGE_STEPS`], or of a run of [`METHOD_STEPS`] where that is all there is.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DiscsConfig {
    pub densify_every: usize,
    pub densify_from: usize,
    /// Exclusive.
    pub densify_until: usize,
    /// Mean norm of the gradient with respect to the projected centre, NDC units, above which a disc is densified.
    pub gradient_threshold: f64,
    /// Whether as many discs again are densified for the sum of the absolute gradients of their pixels (GES).
    pub by_quantile: bool,
    /// Discs up to this fraction of the extent are cloned, larger ones split.
    pub clone_scale: f64,
    /// Less opaque discs are removed.
    pub min_opacity: f64,
    /// Fraction of the extent; larger discs are removed from `max_scale_from` on.
    pub max_scale: f64,
    pub max_scale_from: usize,
    /// An interval that would be shorter than [`SHORTEST_RESET`] steps of the run leaves no time to recover: then
    /// opacities are not reset at all.
    pub reset_every: usize,
    /// Opacity at most, after a reset.
    pub reset_opacity: f64,
    /// Of normals with the normals of the depth.
    pub lambda_normal: f64,
    pub normal_from: usize,
    pub lambda_distortion: f64,
    pub distortion_from: usize,
    /// Opacity at the start.
    pub start_opacity: f64,
    /// Scale at the start over the root mean square distance to the 3 nearest points.
    pub start_scale: f64,
}

/// What changes when several Gaussians take the place of one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Relocation {
    /// Opacity and scales (3DGS-MCMC).
    Mcmc,
    /// Opacity alone (DBS).
    Beta,
}

/// What one stage trains.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StageKind {
    Discs,
    Gaussians(Relocation),
    Joint,
}

impl fmt::Display for StageKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Discs => "2dgs",
            Self::Gaussians(Relocation::Mcmc) => "mcmc",
            Self::Gaussians(Relocation::Beta) => "dbs",
            Self::Joint => "joint",
        })
    }
}

/// One stage of a run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StagePlan {
    pub kind: StageKind,
    /// Steps of the run before it.
    pub begin: usize,
    pub steps: usize,
    /// Length of this stage in the papers, in whose steps its schedule is written.
    pub reference_steps: usize,
    /// Most primitives, as a share of `refine.budget`.
    pub budget_share: f64,
}

impl StagePlan {
    /// Completed steps of the run after its last.
    pub fn end(&self) -> usize {
        self.begin + self.steps
    }

    /// Step of this stage that corresponds to `step` of the papers'.
    pub fn scaled(&self, step: usize) -> usize {
        (step as f64 * self.steps as f64 / self.reference_steps as f64).round() as usize
    }
}

impl Config {
    /// The stages of a run in their order, the last one never empty. A stage whose result comes from a file is left
    /// out, and the run is so much shorter.
    pub fn plan(&self) -> Vec<StagePlan> {
        let (all, stages) = (self.train.steps, &self.stages);
        let alone =
            |kind| vec![StagePlan { kind, begin: 0, steps: all, reference_steps: METHOD_STEPS, budget_share: 1.0 }];
        match self.train.method {
            Method::Discs => return alone(StageKind::Discs),
            Method::Mcmc => return alone(StageKind::Gaussians(Relocation::Mcmc)),
            Method::Dbs => return alone(StageKind::Gaussians(Relocation::Beta)),
            Method::Dpges => {}
        }
        let share = |share: f64| (share * all as f64).round() as usize;
        let gaussians_by = match stages.gaussians_by {
            GaussianStage::Dbs => Some(Relocation::Beta),
            GaussianStage::Mcmc => Some(Relocation::Mcmc),
            GaussianStage::Rest => None,
        };
        let discs = share(stages.surfels);
        let gaussians = gaussians_by.map_or(0, |_| share(stages.gaussians));
        let mut before = Vec::new();
        if stages.surfels_from.is_empty() {
            before.push((StageKind::Discs, discs, stages.surfel_budget));
        }
        if let (Some(kind), true) = (gaussians_by, stages.gaussians_from.is_empty()) {
            before.push((StageKind::Gaussians(kind), gaussians, stages.gaussian_budget));
        }
        let mut plan: Vec<StagePlan> = Vec::new();
        let mut begin = 0;
        for (kind, steps, budget_share) in before.into_iter().filter(|(_, steps, _)| *steps > 0) {
            plan.push(StagePlan { kind, begin, steps, reference_steps: STAGE_STEPS, budget_share });
            begin += steps;
        }
        let steps = all.saturating_sub(discs + gaussians).max(1);
        let joint =
            StagePlan { kind: StageKind::Joint, begin, steps, reference_steps: REFERENCE_STEPS, budget_share: 1.0 };
        plan.push(joint);
        plan
    }

    /// Steps of all stages.
    pub fn total_steps(&self) -> usize {
        self.plan().last().map_or(0, StagePlan::end)
    }

    /// Steps of the last stage.
    pub fn last_stage_steps(&self) -> usize {
        self.plan().last().map_or(0, |stage| stage.steps)
    }

    /// Whether surfels or Gaussians have been trained when they come together.
    pub fn joins_trained(&self) -> bool {
        let stages = &self.stages;
        self.plan().len() > 1 || !stages.surfels_from.is_empty() || !stages.gaussians_from.is_empty()
    }
}

/// Length of a stage in whose steps `[discs]` and `[relocation]` are written (DP-GES).
pub const STAGE_STEPS: usize = 20_000;
/// The same where a method is all that is trained (2DGS, 3DGS-MCMC).
pub const METHOD_STEPS: usize = 30_000;
/// Steps that opacities need to recover from a reset: at 0.05 a step, a logit comes from 0.01 to ½ in about 100.
pub const SHORTEST_RESET: usize = 500;

impl Default for DiscsConfig {
    fn default() -> Self {
        Self {
            densify_every: 100,
            densify_from: 500,
            densify_until: 15_000,
            gradient_threshold: 2e-4,
            by_quantile: true,
            clone_scale: 0.01,
            min_opacity: 0.05,
            max_scale: 0.1,
            max_scale_from: 3000,
            reset_every: 3000,
            reset_opacity: 0.01,
            lambda_normal: 0.05,
            normal_from: 7000,
            lambda_distortion: 0.0,
            distortion_from: 3000,
            start_opacity: 0.1,
            start_scale: 1.0,
        }
    }
}

/// Training of Gaussians that are relocated (3DGS-MCMC, DBS); steps as in [`DiscsConfig`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RelocationConfig {
    pub every: usize,
    pub from: usize,
    /// Exclusive.
    pub until: usize,
    /// Factor by which the number of Gaussians grows each time, up to the budget.
    pub growth: f64,
    /// Less opaque Gaussians are relocated.
    pub min_opacity: f64,
    /// Weight of the mean opacity in the loss.
    pub lambda_opacity: f64,
    /// Weight of the mean scale, world units, in the loss.
    pub lambda_scale: f64,
    /// Jitter of positions over their learning rate: 5e5 at every step for 3DGS-MCMC; DBS, which jitters only when it
    /// relocates, takes a tenth.
    pub noise: f64,
    /// Opacity at the start.
    pub start_opacity: f64,
    /// Scale at the start over the root mean square distance to the 3 nearest points (DBS: 1; 3DGS-MCMC: 0.1).
    pub start_scale: f64,
}

impl Default for RelocationConfig {
    fn default() -> Self {
        Self {
            every: 100,
            from: 500,
            until: 25_000,
            growth: 1.05,
            min_opacity: 0.005,
            lambda_opacity: 0.01,
            lambda_scale: 0.01,
            noise: 5e5,
            start_opacity: 0.5,
            start_scale: 1.0,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plan(set: &[&str]) -> Vec<(String, usize, usize)> {
        let set: Vec<String> = set.iter().map(|&text| text.to_owned()).collect();
        let plan = Config::resolve(None, None, &set).unwrap().plan();
        plan.iter().map(|stage| (stage.kind.to_string(), stage.begin, stage.steps)).collect()
    }

    fn stage(kind: &str, begin: usize, steps: usize) -> (String, usize, usize) {
        (kind.to_owned(), begin, steps)
    }

    #[test]
    fn stages_share_the_steps_of_the_run() {
        let both = ["train.steps=1000", "stages.surfels=0.2", "stages.gaussians=0.3"];
        assert_eq!(plan(&both), [stage("2dgs", 0, 200), stage("dbs", 200, 300), stage("joint", 500, 500)]);
        let with = |more: &'static str| plan(&[&both[..], &[more]].concat());
        assert_eq!(with("stages.surfels=0"), [stage("dbs", 0, 300), stage("joint", 300, 700)]);
        assert_eq!(with("stages.gaussians_by=rest"), [stage("2dgs", 0, 200), stage("joint", 200, 800)]);
        assert_eq!(with("stages.gaussians_by=mcmc")[1], stage("mcmc", 200, 300));
        assert_eq!(with("stages.surfels_from=a"), [stage("dbs", 0, 300), stage("joint", 300, 500)]);
        assert_eq!(with("stages.gaussians_from=a"), [stage("2dgs", 0, 200), stage("joint", 200, 500)]);
        assert_eq!(with("train.method=2dgs"), [stage("2dgs", 0, 1000)]);
        assert_eq!(plan(&["train.steps=1", "stages.surfels=0", "stages.gaussians=0"]), [stage("joint", 0, 1)]);
    }
}
