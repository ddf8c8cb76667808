//! Applies the decisions of [`crate::refine`] to blended Gaussians.

use burn::tensor::{DType, Int, Tensor};
use dpges_core::ops::blend::contributing;
use dpges_core::ops::jitter::{JitterOptions, NoiseGate, jitter};
use dpges_core::render::blended::BlendedOptions;
use dpges_core::scene::Gaussians;
use rand::RngExt;

use super::super::{Context, TrainError};
use super::BlendedStage;
use super::schedule::{BlendedDue, CAPPED_OPACITY, decay};
use crate::config::{Blended, Density, GaussianStage, Relocation};
use crate::optimizer::unit_of;
use crate::refine::densify::{ByAbsolute, DensifyRule, densify, reset_opacities};
use crate::refine::mcmc_relocation::{grown, relocate_and_add};

/// Largest opacity after a reset (3DGS).
const RESET_OPACITY: f64 = 0.01;
/// Mean norm of the sums of absolute gradients above which a Gaussian is split, per NDC unit (AbsGS).
const ABSOLUTE_THRESHOLD: f64 = 4e-4;
/// Scale up to which a primitive is cloned, larger ones are split, extents (3DGS: `percent_dense`).
const DENSE_FRACTION: f64 = 0.01;
/// The same in AbsGS.
const ABSOLUTE_DENSE_FRACTION: f64 = 0.001;
/// Opacity below which a disc is removed (2DGS).
const DISC_MIN_OPACITY: f64 = 0.05;
/// Opacity below which a Gaussian is removed or relocated (3DGS, 3DGS-MCMC).
const MIN_OPACITY: f64 = 0.005;
/// Weight that a Gaussian needs at some pixel of some training view to stay, where what is not needed goes (HTGS).
const NEEDED_WEIGHT: f64 = 0.01;
/// Scale above which a primitive is removed, extents (3DGS).
const MAX_SCALE: f64 = 0.1;
/// Step from which it is.
const MAX_SCALE_FROM: usize = 3000;
/// Factor on the number of Gaussians with each relocation, up to the budget (3DGS-MCMC).
const GROWTH: f64 = 1.05;
/// Noise on positions relative to their learning rate, per squared world unit of a scene of the usual extent (3DGS-MCMC).
const NOISE: f64 = 5e5;
/// Jitter of DBS over that of 3DGS-MCMC, where both relocate.
const BETA_NOISE: f64 = 0.1;

impl BlendedStage {
    /// Does what is `due` after `completed` steps. Returns a sentence for each thing it did.
    pub fn refine_due(
        &mut self,
        due: BlendedDue,
        completed: usize,
        context: &mut Context,
    ) -> Result<Vec<String>, TrainError> {
        let mut events = Vec::new();
        if due.densify {
            events.push(self.densify(completed, context));
        }
        if due.reset {
            self.limit_opacities(RESET_OPACITY);
            events.push(format!("opacities reset to at most {RESET_OPACITY}"));
        }
        if due.cap {
            self.limit_opacities(CAPPED_OPACITY);
        }
        if due.decay {
            self.decay_opacities();
        }
        if due.prune {
            events.extend(self.remove_unneeded(context)?);
        }
        if let (true, Some(limit)) = (due.measure, &mut self.sampling_limit) {
            limit.measure(&self.gaussians.columns.positions.raw(), context);
        }
        if let (true, Some(kind)) = (due.relocate, self.blended.relocation()) {
            self.relocate(kind, context);
            if kind == Relocation::Beta {
                self.jitter(NoiseGate::Beta, completed, context)?;
            }
        }
        Ok(events)
    }

    fn limit_opacities(&mut self, at_most: f64) {
        let opacities = reset_opacities(&self.gaussians.opacities(), at_most as f32);
        self.gaussians.reset_opacities(&opacities);
    }

    /// Multiplies all opacities; Adam starts again with them, as in the published code (HTGS).
    fn decay_opacities(&mut self) {
        let (_, factor) = decay(self.plan);
        let opacities: Vec<f32> = self.gaussians.opacities().iter().map(|opacity| opacity * factor as f32).collect();
        self.gaussians.reset_opacities(&opacities);
    }

    /// Removes the Gaussians that weigh less than [`NEEDED_WEIGHT`] at every pixel of every training view.
    fn remove_unneeded(&mut self, context: &mut Context) -> Result<Option<String>, TrainError> {
        let gaussians = Gaussians::from_data(&self.drawn(), &context.device, DType::F32);
        let options = BlendedOptions::new(&self.info)?.blend;
        let before = gaussians.len();
        let mut needed: Option<Tensor<1, Int>> = None;
        for view in &context.dataset.train {
            let marks = contributing(&gaussians, &view.camera, &options, NEEDED_WEIGHT)?;
            needed = Some(if let Some(needed) = needed { needed.max_pair(marks) } else { marks });
        }
        let Some(needed) = needed else { return Ok(None) };
        let is_needed: Vec<bool> = needed.into_data().iter::<i64>().map(|mark| mark > 0).collect();
        let keep: Vec<usize> = (0..before).filter(|&row| is_needed[row]).collect();
        if keep.is_empty() || keep.len() == before {
            return Ok(None);
        }
        self.gaussians.keep(&keep);
        self.restart_observations(context);
        Ok(Some(format!("{} of {before} Gaussians removed that no training view needs", before - keep.len())))
    }

    fn densify_rule(&self, completed: usize, context: &Context) -> DensifyRule {
        let (flat, density) = match self.blended {
            Blended::Controlled(density) => (false, density),
            // discs of DP-GES are those of 2DGS; GES densifies as many again by absolute gradients
            _ if context.config.stages.gaussians_by == GaussianStage::Dbs => (true, Density::Signed),
            _ => (true, Density::Smoothed),
        };
        let (by_absolute, dense_fraction) = match density {
            Density::Signed | Density::SignedByRays | Density::Summed => (ByAbsolute::Nothing, DENSE_FRACTION),
            Density::Absolute => (ByAbsolute::Splits(ABSOLUTE_THRESHOLD), ABSOLUTE_DENSE_FRACTION),
            Density::Smoothed | Density::Hybrid => (ByAbsolute::Quantile, DENSE_FRACTION),
        };
        // what is summed is never removed
        let removes = density != Density::Summed;
        DensifyRule {
            gradient_threshold: context.config.density.gradient_threshold,
            by_absolute,
            dense_fraction,
            min_opacity: match (removes, flat) {
                (false, _) => 0.0,
                (true, true) => DISC_MIN_OPACITY,
                (true, false) => MIN_OPACITY,
            },
            max_scale_fraction: (removes && completed >= self.plan.scaled(MAX_SCALE_FROM)).then_some(MAX_SCALE),
            flat,
            draws_clones: density == Density::Hybrid,
        }
    }

    /// Clones or splits the primitives whose pictures want them to move, and removes faint and large ones.
    fn densify(&mut self, completed: usize, context: &mut Context) -> String {
        let rule = self.densify_rule(completed, context);
        let before = self.gaussians.len();
        let room = context.most_primitives(self.plan.budget_share).saturating_sub(before);
        let edit = densify(
            &self.gaussians.to_data(),
            &self.screen_gradients.sums(),
            self.info.extent,
            &rule,
            room,
            &mut context.rng,
        );
        self.gaussians.edit(&edit);
        self.restart_observations(context);
        let (removed, added) = (before - edit.keep.len(), edit.added.len());
        let what = if self.blended == Blended::Discs { "discs" } else { "Gaussians" };
        format!("{added} of {before} {what} added by densification, {removed} removed")
    }

    /// Moves faint Gaussians to where opaque ones are, and adds some, up to the budget. This happens every few steps, so
    /// it is no event, only a message for those who ask for details.
    fn relocate(&mut self, kind: Relocation, context: &mut Context) {
        let cap = context.most_primitives(self.plan.budget_share);
        let gaussians = self.gaussians.to_data();
        let target = grown(gaussians.len(), GROWTH, cap);
        let Some(relocated) = relocate_and_add(&gaussians, target, MIN_OPACITY, kind, &mut context.rng) else { return };
        self.gaussians.relocate(&relocated);
        if let Some(momenta) = &mut self.momenta {
            momenta.relocate(&relocated);
        }
        self.restart_observations(context);
        tracing::debug!("{} Gaussians relocated, {} added", relocated.relocated, relocated.added);
    }

    /// Moves Gaussians at random, faint ones most.
    pub fn jitter(&mut self, gate: NoiseGate, completed: usize, context: &mut Context) -> Result<(), TrainError> {
        let factor = if gate == NoiseGate::Beta { BETA_NOISE } else { 1.0 };
        let amount =
            NOISE * factor * self.position_rate(completed, &context.config) / unit_of(self.info.extent).powi(2);
        if amount > 0.0 {
            let options = JitterOptions { gate, amount, seed: context.rng.random() };
            let positions = jitter(&self.gaussians.values(), &options)?;
            self.gaussians.columns.positions.set_tensor(positions);
        }
        Ok(())
    }
}
