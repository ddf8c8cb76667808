//! Applies the decisions of [`crate::refine`] to blended Gaussians.

use dpges_core::ops::jitter::{JitterOptions, NoiseGate, jitter};
use rand::RngExt;

use super::super::{Context, TrainError};
use super::schedule::BlendedDue;
use super::{BlendedStage, ScreenGradients};
use crate::config::Relocation;
use crate::refine::densify::{DensifyRule, densify, reset_opacities};
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
            let discs = &context.config.discs;
            let opacities = reset_opacities(&self.gaussians.opacities(), discs.reset_opacity as f32);
            self.gaussians.reset_opacities(&opacities);
            events.push(format!("opacities reset to at most {}", discs.reset_opacity));
        }
        if let (true, Some(kind)) = (due.relocate, self.relocation) {
            self.relocate(kind, context);
            if kind == Relocation::Beta {
                self.jitter(NoiseGate::Beta, completed, context)?;
            }
        }
        Ok(events)
    }

    /// Clones or splits the discs whose pictures want them to move, and removes faint and large ones.
    fn densify(&mut self, completed: usize, context: &mut Context) -> String {
        let discs = &context.config.discs;
        let rule = DensifyRule {
            gradient_threshold: discs.gradient_threshold,
            by_quantile: discs.by_quantile,
            dense_fraction: discs.dense_fraction,
            min_opacity: discs.min_opacity,
            max_scale_fraction: (completed >= self.plan.scaled(discs.max_scale_from)).then_some(discs.max_scale),
            flat: true,
        };
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
        self.screen_gradients = ScreenGradients::new(self.gaussians.len(), &context.device);
        let (removed, added) = (edit.rows.removed_from(before), edit.added.len());
        format!("{added} of {before} discs added by densification, {removed} removed")
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
        self.screen_gradients = ScreenGradients::new(self.gaussians.len(), &context.device);
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
