//! Applies the decisions of [`crate::refine`] to blended Gaussians.

use dpges_core::ops::jitter::{JitterOptions, NoiseGate, jitter};
use rand::RngExt;

use super::super::{Context, TrainError};
use super::BlendedStage;
use super::schedule::{BlendedDue, CAPPED_OPACITY};
use crate::config::{Blended, Density, Relocation};
use crate::refine::densify::{ByAbsolute, DensifyRule, densify, reset_opacities};
use crate::refine::relocate::{grown, relocate_and_add};

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
            let config = &context.config;
            let discs = self.blended == Blended::Discs;
            let at_most = if discs { config.discs.reset_opacity } else { config.density.reset_opacity };
            self.limit_opacities(at_most);
            events.push(format!("opacities reset to at most {at_most}"));
        }
        if due.cap {
            self.limit_opacities(CAPPED_OPACITY);
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

    fn densify_rule(&self, completed: usize, context: &Context) -> DensifyRule {
        let (discs, density) = (&context.config.discs, &context.config.density);
        let from = |step: usize, limit: f64| (completed >= self.plan.scaled(step)).then_some(limit);
        let Blended::Controlled(kind) = self.blended else {
            return DensifyRule {
                gradient_threshold: discs.gradient_threshold,
                by_absolute: if discs.by_quantile { ByAbsolute::Quantile } else { ByAbsolute::Nothing },
                dense_fraction: discs.dense_fraction,
                min_opacity: discs.min_opacity,
                max_scale_fraction: from(discs.max_scale_from, discs.max_scale),
                flat: true,
            };
        };
        let (by_absolute, dense_fraction) = match kind {
            Density::Signed | Density::SignedByRays | Density::Summed => (ByAbsolute::Nothing, density.dense_fraction),
            Density::Absolute => (ByAbsolute::Splits(density.absolute_threshold), density.absolute_dense_fraction),
            Density::Smoothed => (ByAbsolute::Quantile, density.dense_fraction),
        };
        // what is summed is never removed
        let removes = kind != Density::Summed;
        DensifyRule {
            gradient_threshold: density.gradient_threshold,
            by_absolute,
            dense_fraction,
            min_opacity: if removes { density.min_opacity } else { 0.0 },
            max_scale_fraction: from(density.max_scale_from, density.max_scale).filter(|_| removes),
            flat: false,
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
        let (removed, added) = (edit.rows.removed_from(before), edit.added.len());
        let what = if self.blended == Blended::Discs { "discs" } else { "Gaussians" };
        format!("{added} of {before} {what} added by densification, {removed} removed")
    }

    /// Moves faint Gaussians to where opaque ones are, and adds some, up to the budget. This happens every few steps, so
    /// it is no event, only a message for those who ask for details.
    fn relocate(&mut self, kind: Relocation, context: &mut Context) {
        let relocation = &context.config.relocation;
        let cap = context.most_primitives(self.plan.budget_share);
        let gaussians = self.gaussians.to_data();
        let target = grown(gaussians.len(), relocation.growth, cap);
        let min_opacity = relocation.min_opacity;
        let Some(relocated) = relocate_and_add(&gaussians, target, min_opacity, kind, &mut context.rng) else { return };
        self.gaussians.relocate(&relocated);
        if let Some(momenta) = &mut self.momenta {
            momenta.relocate(&relocated);
        }
        self.restart_observations(context);
        tracing::debug!("{} Gaussians relocated, {} added", relocated.relocated, relocated.added);
    }

    /// Moves Gaussians at random, faint ones most.
    ///
    /// # Errors
    /// [`TrainError::Core`] if the operation refuses the parameters.
    pub fn jitter(&mut self, gate: NoiseGate, completed: usize, context: &mut Context) -> Result<(), TrainError> {
        let relocation = &context.config.relocation;
        let factor = if gate == NoiseGate::Beta { BETA_NOISE } else { 1.0 };
        let amount = relocation.noise * factor * self.position_rate(completed, &context.config);
        if amount > 0.0 {
            let options = JitterOptions { gate, amount, seed: context.rng.random() };
            let positions = jitter(&self.gaussians.values(), &options)?;
            self.gaussians.columns.positions.set_tensor(positions);
        }
        Ok(())
    }
}
