//! The stages of a run: what is trained before surfels and Gaussians are trained together, or instead (DP-GES).

use std::fmt;
use std::path::Path;

use dpges_core::scene::{BlendOrder, ColourModel, OpacityActivation, Rendering, ScreenFilter, Transparency};

use super::{Config, ConfigError, GaussianStage, Method};

/// Length of the joint stage for which the steps in `[refine]` are given (DP-GES).
pub const REFERENCE_STEPS: usize = 25_000;
/// Length of a stage of discs or Gaussians for which its schedule is given (DP-GES).
pub const STAGE_STEPS: usize = 20_000;
/// The same if a method is trained alone (2DGS, 3DGS-MCMC).
pub const METHOD_STEPS: usize = 30_000;
/// Smallest interval of opacity resets: steps for opacities to recover in. At 0.05 per step, a logit rises from an opacity
/// of 0.01 to ½ in about 100.
pub const SHORTEST_RESET: usize = 500;

/// Standard deviation of the filter of Mip-Splatting, px: √0.2 with the digits of its measurements.
const MIP_SPLATTING_PX: f64 = 0.447_213_6;

/// Longest side from which on training views are learnt from at half of their size first, px.
pub const COARSE_FROM: usize = 300;

/// Largest number of steps after scaling; f64 does not hold much larger whole numbers exactly.
const MOST_SCALED_STEPS: f64 = 1e15;

/// Rule by which several Gaussians take the place of one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Relocation {
    /// Opacity and scales (3DGS-MCMC).
    Mcmc,
    /// Opacity alone (DBS).
    Beta,
    /// Opacity and scales of Student's t kernels (SSS).
    Student,
}

/// How adaptive density control chooses what to clone and to split (3DGS).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Density {
    /// By gradients whose parts cancel (3DGS).
    Signed,
    /// Splits by the sums of absolute gradients (AbsGS).
    Absolute,
    /// As [`Self::Signed`], of Gaussians that are blended in the order of each pixel's own ray (StopThePop).
    SignedByRays,
    /// By both, as many by absolute sums as by the others; with the filters of Mip-Splatting.
    Smoothed,
    /// As [`Smoothed`](Self::Smoothed), of Gaussians that rays meet without a projection; opacities decay, clones are drawn from
    /// their originals, and what no picture needs is removed (HTGS).
    Hybrid,
    /// As [`Signed`](Self::Signed), of Gaussians that are summed in any order; none is removed, and no opacity is reset.
    Summed,
}

/// How a set of blended primitives changes while it is trained.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Blended {
    /// Discs, under adaptive density control (2DGS).
    Discs,
    /// Gaussians under adaptive density control.
    Controlled(Density),
    /// Gaussians that are relocated.
    Relocated(Relocation),
}

impl Blended {
    pub fn relocation(self) -> Option<Relocation> {
        if let Self::Relocated(relocation) = self { Some(relocation) } else { None }
    }

    pub fn rendering(self) -> Rendering {
        match self {
            Self::Discs => Rendering::Discs,
            Self::Relocated(Relocation::Student) => Rendering::Students,
            Self::Controlled(Density::Summed) => Rendering::Summed,
            Self::Controlled(_) | Self::Relocated(_) => Rendering::Ellipsoids,
        }
    }

    /// The colour model of its scenes, for colours of `model`: opacities of summed Gaussians depend on the direction as their
    /// colours do.
    pub fn colour_model(self, model: ColourModel) -> ColourModel {
        if self.rendering() == Rendering::Summed { model.with_opacity() } else { model }
    }

    /// The low-pass filter of its paper; what is handed on to the joint stage must look the same there.
    pub fn screen_filter(self) -> ScreenFilter {
        match self {
            Self::Controlled(Density::Signed | Density::SignedByRays | Density::Absolute | Density::Summed) => {
                ScreenFilter::Plain
            }
            Self::Relocated(Relocation::Student) => ScreenFilter::Off,
            _ => ScreenFilter::Compensated,
        }
    }

    /// `transparency` is what `density.transparency` asks for.
    pub fn blend_order(self, transparency: Transparency) -> BlendOrder {
        match self {
            Self::Controlled(Density::SignedByRays) => BlendOrder::Rays,
            Self::Controlled(Density::Hybrid) => BlendOrder::Whitened(transparency),
            _ => BlendOrder::Centres,
        }
    }

    /// Whether its Gaussians have a filter in the world (Mip-Splatting).
    pub fn smooths(self) -> bool {
        matches!(self, Self::Controlled(Density::Smoothed | Density::Hybrid))
    }

    /// How opacities follow from the numbers that are trained.
    pub fn opacity(self) -> OpacityActivation {
        if self == Self::Relocated(Relocation::Student) { OpacityActivation::Tanh } else { OpacityActivation::Sigmoid }
    }
}

/// Primitives that one stage trains.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StageKind {
    Blended(Blended),
    Joint,
}

impl fmt::Display for StageKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Blended(Blended::Discs) => "2dgs",
            Self::Blended(Blended::Relocated(Relocation::Mcmc)) => "mcmc",
            Self::Blended(Blended::Relocated(Relocation::Beta)) => "dbs",
            Self::Blended(Blended::Relocated(Relocation::Student)) => "sss",
            Self::Blended(Blended::Controlled(Density::Signed)) => "3dgs",
            Self::Blended(Blended::Controlled(Density::Absolute)) => "absgs",
            Self::Blended(Blended::Controlled(Density::SignedByRays)) => "stopthepop",
            Self::Blended(Blended::Controlled(Density::Smoothed)) => "mip-splatting",
            Self::Blended(Blended::Controlled(Density::Hybrid)) => "htgs",
            Self::Blended(Blended::Controlled(Density::Summed)) => "sortfree",
            Self::Joint => "joint",
        })
    }
}

/// One stage of a run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StagePlan {
    pub kind: StageKind,
    /// Steps of the run before the first of the stage.
    pub begin: usize,
    pub steps: usize,
    /// Length of the stage for which its schedule is given.
    pub reference_steps: usize,
    /// Largest number of primitives, as a share of `refine.budget`; infinite without a limit.
    pub budget_share: f64,
    /// Whether it learns from training views of half the width and height, with no more primitives than are budgeted by their pixels.
    pub is_coarse: bool,
}

impl fmt::Display for StagePlan {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.is_coarse && self.kind == StageKind::Joint { f.write_str("coarse") } else { self.kind.fmt(f) }
    }
}

impl StagePlan {
    /// Completed steps of the run after the last of the stage.
    pub fn end(&self) -> usize {
        self.begin + self.steps
    }

    /// Step of this stage that corresponds to `step` of a stage of [`reference_steps`](Self::reference_steps).
    pub fn scaled(&self, step: usize) -> usize {
        (step as f64 * self.steps as f64 / self.reference_steps as f64).round() as usize
    }
}

impl Method {
    /// The primitives of its one stage of blended primitives; `None` for DP-GES.
    pub fn alone(self) -> Option<Blended> {
        Some(match self {
            Self::Dpges => return None,
            Self::Discs => Blended::Discs,
            Self::Mcmc => Blended::Relocated(Relocation::Mcmc),
            Self::Dbs => Blended::Relocated(Relocation::Beta),
            Self::Gaussians3d => Blended::Controlled(Density::Signed),
            Self::Absolute => Blended::Controlled(Density::Absolute),
            Self::StopThePop => Blended::Controlled(Density::SignedByRays),
            Self::MipSplatting => Blended::Controlled(Density::Smoothed),
            Self::Htgs => Blended::Controlled(Density::Hybrid),
            Self::Sss => Blended::Relocated(Relocation::Student),
            Self::SortFree => Blended::Controlled(Density::Summed),
        })
    }

    /// `key=value` of its paper that differ from the defaults, which are those of DP-GES.
    pub fn settings(self) -> &'static [&'static str] {
        match self {
            Self::Gaussians3d
            | Self::Absolute
            | Self::StopThePop
            | Self::MipSplatting
            | Self::Htgs
            | Self::SortFree => &[
                "model.colour=sh3",
                "init.limit_scales=false",
                "optimizer.quaternions=1e-3",
                "optimizer.log_scales=5e-3",
                "optimizer.base=2.5e-3",
                "optimizer.detail=1.25e-4",
                "optimizer.decay=1",
            ],
            // the squares of its rates of positions, which are 1.02 to 1.03 times those of 3DGS
            Self::Sss => &[
                "model.colour=sh3",
                "init.limit_scales=false",
                "optimizer.position_start=1.64584e-4",
                "optimizer.position_end=1.64609e-6",
                "optimizer.quaternions=1e-3",
                "optimizer.log_scales=5e-3",
                "optimizer.base=2.5e-3",
                "optimizer.detail=1.25e-4",
                "optimizer.decay=1",
            ],
            Self::Dpges | Self::Discs | Self::Mcmc | Self::Dbs => &[],
        }
    }
}

impl Config {
    /// The stages of a run on training views with this longest side, px, in their order; the last has at least one step. A stage
    /// whose result comes from a file is left out, and the run is shorter by its steps.
    pub fn plan(&self, longest_side: usize) -> Vec<StagePlan> {
        let mut plan = self.plan_at_one_size();
        let stages = &self.stages;
        let begins_anew = stages.surfels == 0.0 && stages.surfels_from.is_empty() && stages.gaussians_from.is_empty();
        let end = (stages.coarse * self.train.steps as f64).round() as usize;
        let joint = plan.last_mut().filter(|last| last.kind == StageKind::Joint && longest_side >= COARSE_FROM);
        let Some(joint) = joint.filter(|joint| begins_anew && (joint.begin + 1..joint.end()).contains(&end)) else {
            return plan;
        };
        let fine = StagePlan { begin: end, steps: joint.end() - end, ..*joint };
        joint.steps = end - joint.begin;
        plan.iter_mut().for_each(|stage| stage.is_coarse = true);
        plan.push(fine);
        plan
    }

    fn plan_at_one_size(&self) -> Vec<StagePlan> {
        let (all, stages) = (self.train.steps, &self.stages);
        let stage = |kind, [begin, steps]: [usize; 2], reference_steps, budget_share| StagePlan {
            kind,
            begin,
            steps,
            reference_steps,
            budget_share,
            is_coarse: false,
        };
        if let Some(blended) = self.train.method.alone() {
            return vec![stage(StageKind::Blended(blended), [0, all], METHOD_STEPS, 1.0)];
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
            let share = if stages.surfel_budget > 0.0 { stages.surfel_budget } else { f64::INFINITY };
            before.push((StageKind::Blended(Blended::Discs), discs, share));
        }
        if let (Some(kind), true) = (gaussians_by, stages.gaussians_from.is_empty()) {
            let kind = StageKind::Blended(Blended::Relocated(kind));
            before.push((kind, gaussians, stages.gaussian_budget));
        }
        let mut plan: Vec<StagePlan> = Vec::new();
        let mut begin = 0;
        for (kind, steps, budget_share) in before.into_iter().filter(|(_, steps, _)| *steps > 0) {
            plan.push(stage(kind, [begin, steps], STAGE_STEPS, budget_share));
            begin += steps;
        }
        let steps = all.saturating_sub(discs + gaussians).max(1);
        plan.push(stage(StageKind::Joint, [begin, steps], REFERENCE_STEPS, 1.0));
        plan
    }

    /// Makes the run `factor` times as long. The schedules of its stages and the steps in `[refine]` scale with it; `train.evaluate_every` and `train.checkpoint_every` remain numbers of steps of the longer or shorter run.
    ///
    /// # Errors
    /// [`ConfigError::Range`] if the result is not from 1 to 1e15 steps, which includes every factor that is not
    /// positive and finite.
    pub fn scale_steps(&mut self, factor: f64) -> Result<(), ConfigError> {
        let before = self.train.steps;
        let steps = (before as f64 * factor).round();
        if !(1.0..=MOST_SCALED_STEPS).contains(&steps) {
            let found = format!("{before} × {factor} = {steps}");
            return Err(ConfigError::Range { key: "train.steps", found, expected: "1 to 1e15".to_owned() });
        }
        self.train.steps = steps as usize;
        Ok(())
    }

    /// Steps of all stages.
    pub fn total_steps(&self) -> usize {
        self.plan_at_one_size().last().map_or(0, StagePlan::end)
    }

    /// Standard deviation of the filter in the world of a stage of Mip-Splatting, px.
    pub fn mip_splatting_px(&self) -> f64 {
        if self.model.sampling_limit > 0.0 { self.model.sampling_limit } else { MIP_SPLATTING_PX }
    }

    /// The file of the block that the run trains; `None` if it trains all.
    pub fn block(&self) -> Option<&Path> {
        (!self.train.block.is_empty()).then(|| Path::new(&self.train.block))
    }

    /// Whether surfels or Gaussians have been trained before the joint stage of `plan`.
    pub fn joins_trained(&self, plan: &StagePlan) -> bool {
        let stages = &self.stages;
        plan.begin > 0 || !stages.surfels_from.is_empty() || !stages.gaussians_from.is_empty()
    }
}

/// Reads a factor for [`Config::scale_steps`].
pub fn factor(text: &str) -> Result<f64, String> {
    let factor = text.parse().ok().filter(|factor: &f64| factor.is_finite() && *factor > 0.0);
    factor.ok_or_else(|| "expected a positive, finite number, such as 0.1 for a tenth of the steps".to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::TrainConfig;

    fn plan(set: &[&str]) -> Vec<(String, usize, usize)> {
        plan_of(set, COARSE_FROM - 1)
    }

    fn plan_of(set: &[&str], longest_side: usize) -> Vec<(String, usize, usize)> {
        let plan = Config::with(set).unwrap().plan(longest_side);
        plan.iter().map(|stage| (stage.to_string(), stage.begin, stage.steps)).collect()
    }

    fn stage(kind: &str, begin: usize, steps: usize) -> (String, usize, usize) {
        (kind.to_owned(), begin, steps)
    }

    #[test]
    fn stages_share_the_steps_of_the_run() {
        let both = ["train.steps=1000", "stages.surfels=0.2", "stages.gaussians=0.3", "stages.gaussians_by=dbs"];
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

    #[test]
    fn large_views_are_learnt_from_at_half_of_their_size_first() {
        let set = ["train.steps=1000", "stages.gaussians=0.2", "stages.coarse=0.7"];
        let large = |more: &'static str| plan_of(&[&set[..], &[more]].concat(), COARSE_FROM);
        assert_eq!(plan(&set), [stage("mcmc", 0, 200), stage("joint", 200, 800)]);
        let coarse = [stage("mcmc", 0, 200), stage("coarse", 200, 500), stage("joint", 700, 300)];
        assert_eq!(large("stages.gaussians=0.2"), coarse);
        let is_coarse =
            Config::with(&set).unwrap().plan(COARSE_FROM).iter().map(|stage| stage.is_coarse).collect::<Vec<_>>();
        assert_eq!(is_coarse, [true, true, false]);
        for whole in ["stages.coarse=0", "stages.coarse=0.2", "stages.coarse=1"] {
            assert_eq!(large(whole), plan(&set), "{whole}");
        }
        for other in ["stages.surfels=0.1", "stages.surfels_from=a", "stages.gaussians_from=a", "train.method=mcmc"] {
            assert_eq!(large(other), plan(&[&set[..], &[other]].concat()), "{other}");
        }
    }

    #[test]
    fn weighted_sums_have_harmonics_and_their_opacities_follow() {
        let config = Config::with(&["train.method=sortfree", "model.colour=sh2"]).unwrap();
        assert_eq!(config.scene_model().to_string(), "sh2+opacity");
        assert_eq!(Config::with(&["train.method=3dgs"]).unwrap().scene_model().to_string(), "sh3");
        for set in [&["train.method=sortfree", "model.colour=sb2"][..], &["model.colour=sh3+opacity"]] {
            let error = Config::with(set).unwrap_err().to_string();
            assert!(error.contains("`model.colour`") && error.contains("train.method"), "{error}");
        }
    }

    #[test]
    fn a_factor_scales_the_steps() {
        let config = |steps| Config { train: TrainConfig { steps, ..Default::default() }, ..Default::default() };
        let mut tenth = config(25_000);
        tenth.scale_steps(0.1).unwrap();
        assert_eq!(tenth, config(2500));
        tenth.scale_steps(1.0001).unwrap();
        assert_eq!(tenth.train.steps, 2500);
        for factor in [0.0, -1.0, 1e-4, f64::NAN, f64::INFINITY, 1e300] {
            let error = tenth.scale_steps(factor).unwrap_err().to_string();
            assert!(error.contains("`train.steps` is 2500 ×") && error.contains("expected 1 to 1e15"), "{error}");
        }
        assert_eq!(tenth.train.steps, 2500);
    }

    #[test]
    fn factors_are_positive_and_finite() {
        assert_eq!(factor("0.25"), Ok(0.25));
        for text in ["0", "-1", "inf", "nan", "half", ""] {
            assert!(factor(text).unwrap_err().contains("positive, finite"), "{text}");
        }
    }
}
